"""From a robot state to joint targets: observation, network, action rule."""
