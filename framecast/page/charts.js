// Curves over time and quality against milliseconds, as SVG.

const SVG = "http://www.w3.org/2000/svg";

function element(name, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, name);
  for (const [key, text] of Object.entries(attributes)) made.setAttribute(key, text);
  made.append(...children);
  return made;
}

/** Round numbers that span low..high, about `count` of them. */
function ticks(low, high, count) {
  const rough = (high - low) / count || 1, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= rough);
  const from = Math.ceil(low / step - 1e-9), to = Math.floor(high / step + 1e-9);
  return Array.from({ length: to - from + 1 }, (_, i) => Number(((from + i) * step).toPrecision(12)));
}

const spread = (values) => {
  const low = Math.min(...values), high = Math.max(...values), room = (high - low || Math.abs(high) || 1) * 0.08;
  return [low - room, high + room];
};

const valuesOf = (one) => one.values[state.metric]?.[state.region] ?? [];
const digits = (metric) => data.metrics[metric]?.digits ?? 4;
const named = (metric) => (metric === "milliseconds" ? "ms" : metric.toUpperCase());
const better = (metric) => (data.metrics[metric]?.higher ? "higher is better" : "lower is better");

/** One curve a method over the frames; a click goes to its frame. */
function drawCurves() {
  const box = document.getElementById("curves"), width = Math.max(240, box.clientWidth), height = 190;
  const margin = { left: 52, right: 14, top: 12, bottom: 30 }, count = run().frames.length;
  const found = run().methods.flatMap(valuesOf).filter((v) => v !== null);
  box.replaceChildren();
  if (!found.length) {
    box.append(Object.assign(document.createElement("p"), { className: "note", textContent: "No frame has a value of this metric here." }));
    return;
  }
  const [low, high] = spread(found);
  const x = (frame) => margin.left + ((frame + 0.5) / count) * (width - margin.left - margin.right);
  const y = (v) => height - margin.bottom - ((v - low) / (high - low)) * (height - margin.top - margin.bottom);
  const chart = element("svg", { width, height, role: "img", "aria-label": curvesInWords() });
  for (const tick of ticks(low, high, 6)) {
    chart.append(
      element("line", { class: "grid", x1: margin.left, x2: width - margin.right, y1: y(tick), y2: y(tick) }),
      element("text", { x: margin.left - 8, y: y(tick) + 4, "text-anchor": "end" }, String(tick)),
    );
  }
  run().frames.forEach((frame, i) => chart.append(element("rect", {
    class: frame.role, x: x(i) - Math.min(4, (x(1) - x(0)) * 0.35), width: Math.min(8, (x(1) - x(0)) * 0.7), y: height - margin.bottom + 3, height: 5,
  })));
  const every = Math.max(1, ...[1, 2, 5, 10, 20, 50, 100, 200, 500].filter((k) => k * 8 <= count));
  run().frames.forEach((frame, i) => {
    if (i % every === 0) chart.append(element("text", { x: x(i), y: height - 6, "text-anchor": "middle" }, String(frame.number)));
  });
  chart.append(element("line", { id: "now", class: "now", y1: margin.top, y2: height - margin.bottom }));
  for (const one of run().methods) chart.append(curve1(one, x, y));
  box.append(chart);
  box.onclick = (event) => {
    const at = event.clientX - box.getBoundingClientRect().left;
    set({ frame: Math.min(count - 1, Math.max(0, Math.floor(((at - margin.left) / (width - margin.left - margin.right)) * count))) });
  };
  drawCurves.x = x;
}

function curve1(one, x, y) {
  const points = valuesOf(one).map((v, frame) => [frame, v]).filter(([, v]) => v !== null);
  const strong = one.name === state.a || one.name === state.b;
  const path = points.map(([frame, v], i) => `${i ? "L" : "M"}${x(frame).toFixed(1)},${y(v).toFixed(1)}`).join("");
  const group = element("g", { class: strong ? "strong" : "", style: `--c: ${color(one.name)}` }, element("path", { d: path }));
  if (points.length < 100) {
    for (const [frame, v] of points) {
      const dot = element("circle", { cx: x(frame), cy: y(v), r: strong ? 4 : 3 });
      dot.append(element("title", {}, `${one.name}, frame ${run().frames[frame].number}: ${v.toFixed(digits(state.metric))}`));
      group.append(dot);
    }
  }
  return group;
}

function curvesInWords() {
  const said = run().methods.map((one) => {
    const found = valuesOf(one).filter((v) => v !== null), d = digits(state.metric);
    return found.length ? `${one.name} ${Math.min(...found).toFixed(d)} to ${Math.max(...found).toFixed(d)}` : `${one.name} none`;
  });
  return `${named(state.metric)} of every frame, ${better(state.metric)}: ${said.join(", ")}`;
}

/** Values of the frame on show, one button a method, which makes it A. */
function drawLegend() {
  const legend = document.getElementById("legend");
  legend.replaceChildren(...run().methods.map((one) => {
    const button = document.createElement("button"), v = valuesOf(one)[state.frame];
    button.type = "button";
    button.style.setProperty("--c", color(one.name));
    button.setAttribute("aria-pressed", one.name === state.a);
    button.append(Object.assign(document.createElement("span"), { textContent: one.name }),
      Object.assign(document.createElement("b"), { textContent: v == null ? "–" : v.toFixed(digits(state.metric)) }));
    button.title = `compare ${one.name}`;
    button.onclick = () => set(state.b === one.name ? { a: one.name, b: state.a } : { a: one.name });
    return button;
  }));
  const now = document.getElementById("now"), x = drawCurves.x?.(state.frame);
  if (now && x) for (const key of ["x1", "x2"]) now.setAttribute(key, x);
}

/** Quality against milliseconds of every method, with the line of those that nothing beats in both. */
function drawScatter() {
  const box = document.getElementById("scatter"), width = Math.max(240, box.clientWidth), height = Math.min(380, Math.max(260, width * 0.5));
  const margin = { left: 56, right: 20, top: 26, bottom: 40 };
  const points = scatterPoints();
  box.replaceChildren();
  if (!points.length) {
    box.append(Object.assign(document.createElement("p"), { className: "note", textContent: "No times were measured for this metric." }));
    return;
  }
  const logs = points.map((p) => Math.log10(p.ms)), [left, right] = [Math.min(...logs) - 0.15, Math.max(...logs) + 0.35];
  const [low, high] = spread(points.map((p) => p.value));
  const x = (ms) => margin.left + ((Math.log10(ms) - left) / (right - left)) * (width - margin.left - margin.right);
  const y = (v) => height - margin.bottom - ((v - low) / (high - low)) * (height - margin.top - margin.bottom);
  const chart = element("svg", { width, height, role: "img", "aria-label": scatterInWords(points) });
  for (const tick of ticks(low, high, 6)) {
    chart.append(element("line", { class: "grid", x1: margin.left, x2: width - margin.right, y1: y(tick), y2: y(tick) }),
      element("text", { x: margin.left - 8, y: y(tick) + 4, "text-anchor": "end" }, String(tick)));
  }
  for (const ms of [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000]) {
    if (Math.log10(ms) < left || Math.log10(ms) > right) continue;
    chart.append(element("line", { class: "grid", y1: margin.top, y2: height - margin.bottom, x1: x(ms), x2: x(ms) }),
      element("text", { x: x(ms), y: height - margin.bottom + 18, "text-anchor": "middle" }, String(ms)));
  }
  chart.append(element("text", { class: "axis", x: width - margin.right, y: height - 4, "text-anchor": "end" }, "milliseconds for a frame"),
    element("text", { class: "axis", x: 4, y: 13 }, `${named(state.metric)}, ${better(state.metric)}`));
  const front = frontOf(points);
  if (front.length > 1) chart.append(element("path", { class: "front", d: front.map((p, i) => `${i ? "L" : "M"}${x(p.ms)},${y(p.value)}`).join("") }));
  placedLabels(points, x, y, width).forEach(({ point, at }) => {
    chart.append(element("circle", { class: "point", style: `--c: ${color(point.name)}`, cx: x(point.ms), cy: y(point.value), r: 6 }),
      element("text", { class: "name", x: at.x, y: at.y, "text-anchor": at.anchor }, point.name));
  });
  box.append(chart);
}

const higher = () => data.metrics[state.metric]?.higher;

/** Means of the run by method: quality in the chosen region, and time. */
function scatterPoints() {
  const role = run().role;
  const rows = data.rows.filter((r) => r.clip === run().clip && r.mode === run().mode && r.scale === run().scale && r.role === role);
  const one = (name, metric, region) => rows.find((r) => r.method === name && r.metric === metric && r.region === region)?.value;
  return run().methods
    .map(({ name }) => ({ name, value: one(name, state.metric, state.region), ms: one(name, "milliseconds", "all") }))
    .filter((p) => p.value !== undefined && p.ms > 0);
}

/** Points that no other one beats in time and in value, by time. */
function frontOf(points) {
  const ahead = (p, q) => (higher() ? p.value > q.value : p.value < q.value);
  return points.filter((p) => !points.some((q) => q !== p && q.ms <= p.ms && !ahead(p, q))).sort((p, q) => p.ms - q.ms);
}

/** Names beside their points: right of it, else left, above or below, where no other name lies. */
function placedLabels(points, x, y, width) {
  const taken = points.map((p) => ({ x: x(p.ms) - 7, y: y(p.value) - 7, w: 14, h: 14 }));
  return points.map((point) => {
    const cx = x(point.ms), cy = y(point.value), w = point.name.length * 7.2, h = 15;
    const spots = [
      { x: cx + 11, y: cy + 4.5, anchor: "start", left: cx + 11 }, { x: cx - 11, y: cy + 4.5, anchor: "end", left: cx - 11 - w },
      { x: cx, y: cy - 12, anchor: "middle", left: cx - w / 2 }, { x: cx, y: cy + 21, anchor: "middle", left: cx - w / 2 },
    ];
    const free = (s) => s.left > 50 && s.left + w < width &&
      !taken.some((t) => s.left < t.x + t.w && t.x < s.left + w && s.y - 12 < t.y + t.h && t.y < s.y - 12 + h);
    const at = spots.find(free) ?? spots[0];
    taken.push({ x: at.left, y: at.y - 12, w, h });
    return { point, at };
  });
}

function scatterInWords(points) {
  const said = points.map((p) => `${p.name} ${p.value.toFixed(digits(state.metric))} in ${p.ms.toFixed(1)} milliseconds`);
  return `${named(state.metric)} against time, ${better(state.metric)}: ${said.join("; ")}`;
}

/** All values of the curves as a table, for those who read rather than look. */
function drawFrameTable() {
  const details = document.getElementById("frames"), table = details.querySelector("table");
  if (!details.open) return;
  const cell = (kind, text, scope) => {
    const made = Object.assign(document.createElement(kind), { textContent: text });
    if (scope) made.scope = scope;
    return made;
  };
  const line = (...cells) => {
    const made = document.createElement("tr");
    made.append(...cells);
    return made;
  };
  const head = document.createElement("thead"), body = document.createElement("tbody");
  head.append(line(cell("th", "frame", "col"), cell("th", "role", "col"), ...run().methods.map((one) => cell("th", one.name, "col"))));
  body.append(...run().frames.map((frame, i) => line(
    cell("th", frame.number, "row"), cell("td", frame.role),
    ...run().methods.map((one) => cell("td", valuesOf(one)[i]?.toFixed(digits(state.metric)) ?? "–")),
  )));
  table.replaceChildren(Object.assign(document.createElement("caption"), { textContent: `${named(state.metric)} of every frame` }), head, body);
}
