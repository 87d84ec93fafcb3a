// Asks for the state of the run every other second and shows it.

import { chart, short } from "./chart.js";
import { Robot } from "./robot.js";

const PERIOD = 2000;
const BEST = "#0b7a75", MUTED = "#8a94a3", ACCENT = "#c8553d";
const at = (id) => document.getElementById(id);
const tell = (text) => { at("body-note").textContent = text; };
const robot = new Robot(at("robot"), tell);
let drawn = null, tag = null;

function make(name, text, kind) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

function duration(seconds) {
  const whole = Math.round(seconds), two = (n) => String(n).padStart(2, "0");
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${two(whole % 60)} s`;
  return `${Math.floor(whole / 3600)} h ${two(Math.floor((whole % 3600) / 60))} min`;
}

const words = (name) => name.replaceAll("_", " ");
const number = (value, digits) => (value === null || value === undefined ? "" : value.toFixed(digits));
const shown = (value) => (typeof value === "number" ? value.toFixed(3) : String(value));

function head(state) {
  document.title = `${state.status}: ${state.folder}`;
  at("title").textContent = [state.folder, state.title && `(${state.title})`].filter(Boolean).join(" ");
  at("status").textContent = state.status;
  at("status").className = `badge ${state.status}`;
  at("words").textContent = state.words;
  const times = [];
  if (state.elapsed) times.push(`${duration(state.elapsed)} so far`);
  if (state.left !== null) times.push(`about ${duration(state.left)} left`);
  if (state.idle !== null) times.push(`last written ${duration(state.idle)} ago`);
  at("times").textContent = times.join(", ");
  at("problems").textContent = state.problems.join("; ");
  at("report").hidden = !state.report;
}

function stages(state) {
  at("stages-box").hidden = !state.stages.length;
  at("stages").replaceChildren(...state.stages.map((stage) => {
    const item = make("li", undefined, stage.status.replace(" ", "-")), row = make("div", undefined, "row");
    const told = [];
    if (stage.total !== null) told.push(`${stage.done} of ${stage.total}`);
    if (stage.seconds !== null) told.push(duration(stage.seconds));
    if (stage.left !== null) told.push(`about ${duration(stage.left)} left`);
    row.append(make("span", stage.name, "name"), make("span", told.join(", ") || stage.status, "muted"));
    item.append(row);
    if (stage.total) {
      const bar = make("div", undefined, "bar"), full = make("div");
      full.style.width = `${Math.min(100, (100 * stage.done) / stage.total)}%`;
      bar.append(full); item.append(bar);
    }
    return item;
  }));
}

function table(target, rows, state) {
  if (!rows.length) { target.textContent = "none yet"; return; }
  const names = Object.keys(rows[0].params), top = make("tr");
  top.append(make("th", "body"), make("th", "from", "text"), ...names.map((name) => make("th", words(name))),
    make("th", state.objective), make("th", "±"), make("th", "tracking error [m/s]"), make("th", "time"),
    make("th", "status", "text"));
  target.replaceChildren(top, ...rows.map((row) => {
    const line = make("tr", undefined, row.repeat === null && row.trial === state.best ? "best" : "");
    line.append(make("td", row.trial), make("td", row.origin, "text"),
      ...names.map((name) => make("td", shown(row.params[name]))), make("td", number(row.score, 4)),
      make("td", number(row.sem, 4)), make("td", number(row.tracking_error, 3)),
      make("td", row.seconds === null ? "" : duration(row.seconds)),
      make("td", row.message ? `${row.status}: ${row.message}` : row.status, "text"));
    return line;
  }));
}

function charts(state) {
  const scored = state.trials.filter((row) => row.score !== null);
  at("convergence").replaceChildren(chart([
    { points: state.trials.filter((r) => r.best_so_far !== null).map((r) => [r.trial, r.best_so_far]), color: BEST, width: 2.5 },
    { points: scored.map((r) => [r.trial, r.score]), bars: scored.map((r) => r.sem || 0), color: MUTED, dots: true,
      labels: scored.map((r) => `body ${r.trial}: ${r.score.toFixed(4)} (${r.origin})`) },
  ], { x: "body", y: state.unit + (state.higher_is_better ? " (higher is better)" : " (lower is better)"), whole: true }));
  at("finetuning").replaceChildren(chart(
    state.trials.filter((r) => r.curve.length).map((r) => ({ points: r.curve, width: r.trial === state.best ? 3 : 1.5,
      color: r.trial === state.best ? BEST : MUTED, opacity: r.trial === state.best ? 1 : 0.6 })),
    { x: "environment steps (the best body in green)", y: "reward per step" }));
  at("training-box").hidden = !state.curves.length;
  at("training").replaceChildren(...state.curves.map((curve) => {
    const box = make("div");
    box.append(make("div", `${curve.stage}: ${curve.quantity}, now ${short(curve.points.at(-1)[1])}`, "muted"),
      chart([{ points: curve.points, color: ACCENT, width: 2 }], { x: "environment steps", y: curve.quantity }));
    return box;
  }));
}

async function triangles(which) {
  const answer = await fetch(`body/${which}`);
  if (!answer.ok) { tell((await answer.text()).trim()); return null; }
  return answer.arrayBuffer();
}

async function body(state) {
  const row = state.trials.find((r) => r.trial === state.best);
  at("body-title").textContent = state.best_is_final ? "Chosen body" : "Best body so far";
  if (state.best === null) {
    tell(state.status === "running" ? "No body has a score yet." : "No body has a score.");
    at("design").replaceChildren();
    return;
  }
  at("design").replaceChildren(...Object.entries(state.best_params).map(([name, value]) => {
    const line = make("tr");
    line.append(make("td", words(name), "text"), make("td", shown(value)));
    return line;
  }));
  const key = JSON.stringify(state.best_params);
  if (key !== drawn) {
    drawn = key;
    const data = await triangles("best");
    if (data) {
      robot.set("best", data);
      tell(`Body ${state.best}${row && row.score !== null ? `, ${state.objective} ${row.score.toFixed(4)}` : ""}. Drag to turn it, scroll to zoom.`);
    }
  }
}

at("ghost").addEventListener("change", async (event) => {
  robot.set("nominal", event.target.checked ? await triangles("nominal") : null);
});

function show(state) {
  head(state); stages(state); charts(state);
  table(at("trials"), state.trials, state);
  at("confirm-box").hidden = !state.confirmations.length;
  at("result").textContent = state.result;
  table(at("confirmations"), state.confirmations, state);
  const log = at("log"), follow = log.scrollTop + log.clientHeight >= log.scrollHeight - 4;
  log.textContent = state.log.join("\n") || "there is no log.txt";
  if (follow) log.scrollTop = log.scrollHeight;
  return body(state);
}

async function step() {
  try {
    if (document.hidden) return;
    const answer = await fetch("state.json", tag ? { headers: { "If-None-Match": tag } } : {});
    at("lost").hidden = true;
    if (answer.status === 304) return;
    if (!answer.ok) throw new Error(answer.statusText);
    tag = answer.headers.get("ETag");
    await show(await answer.json());
  } catch (error) {
    at("lost").hidden = false;
  } finally {
    setTimeout(step, PERIOD);
  }
}

step();
