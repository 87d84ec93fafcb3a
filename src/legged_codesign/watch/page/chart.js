// Line and point charts as SVG.

const SPACE = "http://www.w3.org/2000/svg";
const WIDTH = 520, HEIGHT = 260, LEFT = 62, RIGHT = 12, TOP = 12, BOTTOM = 42;

function element(name, attributes, text) {
  const made = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

// Round steps of 1, 2 or 5 times a power of ten that divide a range into about `count` parts.
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
  const first = Math.ceil(low / step - 1e-9);
  return Array.from({ length: Math.floor(high / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step);
}

export function short(value) {
  if (Math.abs(value) >= 1e6) return `${+(value / 1e6).toPrecision(3)} M`;
  if (Math.abs(value) >= 1e4) return `${+(value / 1e3).toPrecision(3)} k`;
  return String(+value.toPrecision(3));
}

function range(values) {
  let low = Math.min(...values), high = Math.max(...values);
  if (low === high) { const half = Math.abs(low) * 0.1 || 1; low -= half; high += half; }
  return [low, high];
}

// series: [{points: [[x, y]...], color, width, dots, bars: [half height...], labels, opacity}]
export function chart(series, { x, y, whole = false }) {
  const shown = series.filter((s) => s.points.length);
  const svg = element("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${y} by ${x}` });
  if (!shown.length) {
    svg.append(element("text", { x: WIDTH / 2, y: HEIGHT / 2, "text-anchor": "middle" }, "nothing yet"));
    return svg;
  }
  const xs = shown.flatMap((s) => s.points.map((p) => p[0]));
  const ys = shown.flatMap((s) => s.points.flatMap((p, i) => [p[1] - (s.bars?.[i] || 0), p[1] + (s.bars?.[i] || 0)]));
  const [x0, x1] = range(xs), [low, high] = range(ys), margin = 0.06 * (high - low);
  const y0 = low - margin, y1 = high + margin;
  const px = (v) => LEFT + ((v - x0) / (x1 - x0)) * (WIDTH - LEFT - RIGHT);
  const py = (v) => HEIGHT - BOTTOM - ((v - y0) / (y1 - y0)) * (HEIGHT - TOP - BOTTOM);
  for (const value of ticks(y0, y1, 4)) {
    svg.append(element("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: py(value), y2: py(value), stroke: "#e7eaee" }));
    svg.append(element("text", { x: LEFT - 8, y: py(value) + 4, "text-anchor": "end" }, short(value)));
  }
  for (const value of ticks(x0, x1, 5)) {
    if (whole && value % 1) continue;
    svg.append(element("text", { x: px(value), y: HEIGHT - BOTTOM + 18, "text-anchor": "middle" }, short(value)));
  }
  svg.append(element("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, x));
  svg.append(element("text", { transform: `translate(13 ${(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)`,
    "text-anchor": "middle" }, y));
  for (const s of shown) {
    const path = s.points.map((p, i) => `${i ? "L" : "M"}${px(p[0]).toFixed(1)} ${py(p[1]).toFixed(1)}`).join("");
    if (s.width) svg.append(element("path", { d: path, fill: "none", stroke: s.color, "stroke-width": s.width,
      "stroke-opacity": s.opacity ?? 1 }));
    s.points.forEach((p, i) => {
      if (s.bars?.[i]) svg.append(element("line", { x1: px(p[0]), x2: px(p[0]), y1: py(p[1] - s.bars[i]),
        y2: py(p[1] + s.bars[i]), stroke: s.color, "stroke-opacity": 0.5 }));
      if (!s.dots && s.points.length > 1) return;
      const dot = element("circle", { cx: px(p[0]), cy: py(p[1]), r: 4, fill: s.color });
      if (s.labels) dot.append(element("title", {}, s.labels[i]));
      svg.append(dot);
    });
  }
  return svg;
}
