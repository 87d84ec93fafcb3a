"""The robot in the browser with a slider for each design parameter."""
