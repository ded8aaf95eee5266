// The controls: what they show follows from `state`, what they do is a call of `set`.

const $ = (id) => document.getElementById(id);
const KEPT = ["run", "view", "a", "b", "frame", "wipe", "zoom", "x", "y", "exposure", "gain", "row", "metric", "region"];

/** Changes the state; everything on the page follows. */
function set(changes) {
  const before = { ...state };
  Object.assign(state, changes);
  if (state.run !== before.run) entered();
  const charts = ["run", "metric", "region", "a", "b"].some((key) => state[key] !== before[key]);
  if (charts) {
    drawCurves();
    drawScatter();
    drawFrameTable();
  }
  controls();
  if (charts || state.frame !== before.frame) drawLegend();
  remember();
  invalidate();
}

/** Defaults of a run: the best method against the reference, at the generated frame in the middle. */
function entered() {
  const ours = run(), metric = Object.keys(ours.methods[0]?.values ?? {})[0] ?? "";
  if (!ours.methods.some((one) => state.metric in one.values)) state.metric = metric;
  if (!ours.methods.some((one) => one.values[state.metric]?.[state.region])) state.region = "all";
  const generated = ours.frames.flatMap((frame, i) => (frame.role === ours.role ? [i] : []));
  const fresh = { frame: generated[generated.length >> 1] ?? 0, zoom: 0, x: ours.size[1] / 2, y: ours.size[0] / 2, row: ours.size[0] >> 1 };
  if (!names().includes(state.a)) state.a = ours.best;
  if (!names().includes(state.b) || state.b === state.a) state.b = names().find((name) => name !== state.a) ?? state.a;
  Object.assign(state, fresh);
  for (const select of [$("a"), $("b")]) fill(select, names());
  fill($("metric"), [...new Set(ours.methods.flatMap((one) => Object.keys(one.values)))], named);
  $("scrubber").max = ours.frames.length - 1;
  $("row").max = ours.size[0] - 1;
  $("bounce").checked = ours.frames.length < 48;
  warm();
}

function fill(select, options, text = (name) => name) {
  select.replaceChildren(...options.map((name) => new Option(text(name), name)));
}

const seconds = (frame) => `${(frame / run().fps).toFixed(2)} s`;

/** Puts the state into the controls. */
function controls() {
  const frame = run().frames[state.frame], stops = state.exposure;
  $("run").value = state.run;
  $("a").value = state.a;
  $("b").value = state.b;
  $("metric").value = state.metric;
  const regions = [...new Set(run().methods.flatMap((one) => Object.keys(one.values[state.metric] ?? {})))];
  if ($("region").dataset.of !== regions.join()) fill($("region"), regions);
  $("region").dataset.of = regions.join();
  $("region").value = state.region;
  for (const radio of document.getElementsByName("view")) radio.checked = radio.value === state.view;
  for (const part of document.querySelectorAll("[data-for]")) part.hidden = !part.dataset.for.split(" ").includes(state.view);
  $("wipe").parentElement.hidden = !overlaid();
  $("scrubber").value = state.frame;
  $("scrubber").setAttribute("aria-valuetext", `frame ${frame.number}, ${frame.role}`);
  $("where").textContent = `frame ${frame.number} · ${frame.role} · ${seconds(state.frame)}`;
  $("exposure").value = stops;
  $("stops").textContent = `${stops > 0 ? "+" : ""}${stops.toFixed(2)} stops`;
  $("gain").value = Math.log2(state.gain);
  $("times").textContent = `× ${state.gain}`;
  $("wipe").value = Math.round(state.wipe * 100);
  $("row").value = state.row;
  $("rowtext").textContent = state.row + run().window[1];
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  $("play").classList.toggle("on", state.playing);
  $("rate").textContent = `${Number((run().fps * state.speed).toFixed(2))} frames a second`;
  stage.setAttribute("aria-label", inWords());
  stage.style.touchAction = state.zoom || state.view === "wipe" ? "none" : "pan-y";
}

/** What the stage shows, for those who do not see it. */
function inWords() {
  const frame = run().frames[state.frame], score = (name) => {
    const v = name === REFERENCE ? null : method(name).values[state.metric]?.all?.[state.frame];
    return v == null ? name : `${name} (${named(state.metric)} ${v.toFixed(digits(state.metric))})`;
  };
  return `${VIEWS[state.view]} of ${score(state.a)} and ${score(state.b)}, frame ${frame.number} of ${run().frames.length}, ${frame.role}`;
}

let saying = 0;

/** Called after each drawing. */
function drawn() {
  $("zoom").textContent = `${Number((scaleIn(shape.w, shape.h)).toPrecision(2))}×`;
  probe();
  clearTimeout(saying);
  if (!state.playing) saying = setTimeout(() => ($("said").textContent = inWords()), 700);
  document.body.dataset.drawn = "";
  if (!drawing) delete document.body.dataset.waiting;
}

/** Values of the pixel under the pointer, or in the middle of the stage. */
function probe() {
  const at = pointer ? under(pointer) : under({ x: shape.w / 2, y: shape.h / 2 });
  const line = $("probe");
  if (!at) return void (line.innerHTML = "&nbsp;");
  const [left, top] = run().window, i = at.y * run().size[1] + at.x, parts = [`<span>x ${at.x + left}, y ${at.y + top}</span>`];
  for (const name of [...new Set([state.a, state.b])]) {
    const shown = image(imageId(name), probe);
    if (!shown) continue;
    const linear = shown.planes.map((plane) => linearOf(plane[i])), shade = linear.map((v) => Math.round(255 * display(v * 2 ** state.exposure)));
    const map = name === REFERENCE ? null : method(name).flip[state.frame], scored = map && image(map, probe);
    const flip = scored ? ` <i>FLIP ${(scored.planes[0][i] / 255).toFixed(3)}</i>` : "";
    parts.push(`<span><b style="background: rgb(${shade})"></b>${escaped(name)} <code>${linear.map(value).join("&ensp;")}</code>${flip}</span>`);
  }
  line.innerHTML = parts.join("");
}

const escaped = (text) => Object.assign(document.createElement("i"), { textContent: text }).innerHTML;

// Playing.

let began = null;

async function play(on = !state.playing) {
  set({ playing: on });
  if (!on) return;
  await Promise.all(run().frames.flatMap((_, frame) => needed(frame)).map((id) => new Promise((then) => (image(id) ? then() : image(id, then)))));
  began = { at: performance.now(), frame: state.frame };
  requestAnimationFrame(step);
}

function step(now) {
  if (!state.playing || !began) return;
  const count = run().frames.length, passed = Math.floor(((now - began.at) / 1000) * run().fps * state.speed);
  const round = $("bounce").checked ? Math.max(1, 2 * count - 2) : count, at = (began.frame + Math.max(0, passed)) % round;
  const frame = at < count ? at : round - at;
  if (frame !== state.frame) set({ frame });
  requestAnimationFrame(step);
}

/** Images that the view takes of a frame. */
function needed(frame) {
  const shown = state.view === "all" ? names() : [state.a, state.b];
  return [...new Set(shown.map((name) => imageId(name, frame)).filter(Boolean))];
}

/** Decodes, while nothing else is to do, what the scrubber may ask for next. */
function warm() {
  const idle = window.requestIdleCallback ?? ((then) => setTimeout(then, 30)), queue = run().frames.flatMap((_, frame) => needed(frame));
  const next = () => {
    const id = queue.find((one) => !decoded.has(one));
    if (id) image(id, () => idle(next));
  };
  idle(next);
}

setInterval(() => state.view === "flicker" && !$("hold").checked && set({ swapped: !state.swapped }), 500);

// Controls.

for (const [key, id] of [["a", "a"], ["b", "b"], ["metric", "metric"], ["region", "region"]]) {
  $(id).onchange = (event) => set({ [key]: event.target.value });
}
$("run").onchange = (event) => set({ run: Number(event.target.value) });
$("swap").onclick = () => set({ a: state.b, b: state.a });
for (const radio of document.getElementsByName("view")) radio.onchange = () => set({ view: radio.value, swapped: false });
$("scrubber").oninput = (event) => set({ frame: Number(event.target.value), playing: false });
$("exposure").oninput = (event) => set({ exposure: Number(event.target.value) });
$("reset").onclick = () => set({ exposure: 0 });
$("gain").oninput = (event) => set({ gain: 2 ** Number(event.target.value) });
$("wipe").oninput = (event) => set({ wipe: Number(event.target.value) / 100 });
$("row").oninput = (event) => set({ row: Number(event.target.value) });
$("hold").onchange = () => set({ swapped: false });
$("play").onclick = () => play();
$("speed").onchange = (event) => {
  began &&= { at: performance.now(), frame: state.frame };
  set({ speed: Number(event.target.value) });
};
$("fit").onclick = () => set({ zoom: 0 });
$("in").onclick = () => zoomBy(2);
$("out").onclick = () => zoomBy(0.5);
$("save").onclick = () => stage.toBlob((blob) => {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: `${run().clip}-${run().frames[state.frame].number}-${state.view}.png` });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
});
$("frames").ontoggle = drawFrameTable;
$("keys").onclick = () => $("help").showModal();
$("theme").onclick = () => {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches, now = document.documentElement.dataset.theme ?? (dark ? "dark" : "light");
  document.documentElement.dataset.theme = now === "dark" ? "light" : "dark";
};
for (const button of document.querySelectorAll("th button[data-metric]")) {
  button.onclick = () => set({ metric: button.dataset.metric, region: button.dataset.region });
}

const views = Object.keys(VIEWS);
const cycled = (name, step) => names()[(names().indexOf(name) + step + names().length) % names().length];
const moved = (step) => ({ frame: Math.min(run().frames.length - 1, Math.max(0, state.frame + step)), playing: false });

const KEYS = {
  ArrowLeft: () => set(moved(-1)), ArrowRight: () => set(moved(1)),
  Home: () => set({ frame: 0, playing: false }), End: () => set({ frame: run().frames.length - 1, playing: false }),
  "Shift+ArrowLeft": () => pan(60, 0), "Shift+ArrowRight": () => pan(-60, 0),
  "Shift+ArrowUp": () => pan(0, 60), "Shift+ArrowDown": () => pan(0, -60),
  " ": () => play(), "+": () => zoomBy(2), "=": () => zoomBy(2), "-": () => zoomBy(0.5), 0: () => set({ zoom: 0 }),
  a: () => set({ a: cycled(state.a, 1) }), "Shift+A": () => set({ a: cycled(state.a, -1) }),
  b: () => set({ b: cycled(state.b, 1) }), "Shift+B": () => set({ b: cycled(state.b, -1) }),
  x: () => set({ a: state.b, b: state.a }),
  e: () => set({ exposure: Math.min(8, state.exposure + 0.5) }), "Shift+E": () => set({ exposure: Math.max(-8, state.exposure - 0.5) }),
  r: () => set({ exposure: 0 }), "[": () => set({ wipe: Math.max(0, state.wipe - 0.05) }), "]": () => set({ wipe: Math.min(1, state.wipe + 0.05) }),
  f: () => ($("hold").checked = true) && set({ view: "flicker", swapped: state.view === "flicker" && !state.swapped }),
  "?": () => $("help").showModal(),
};

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
  const own = event.target.closest("input, select, button, summary"), typed = event.key.length === 1;
  if (own && (own.matches("select") || (own.matches("input") && !typed) || event.key === " ")) return;
  const key = event.shiftKey && event.key !== "?" && event.key !== "+" ? `Shift+${event.key}` : event.key;
  const view = views[Number(event.key) - 1];
  const act = KEYS[key] ?? (view && (() => set({ view, swapped: false })));
  if (!act) return;
  event.preventDefault();
  act();
});

// The address remembers what is on show.

let remembering = 0;

function remember() {
  clearTimeout(remembering);
  remembering = setTimeout(() => {
    const held = new URLSearchParams(KEPT.map((key) => [key, typeof state[key] === "number" ? Number(state[key].toFixed(4)) : state[key]]));
    history.replaceState(null, "", `#${held}`);
  }, 400);
}

function recalled() {
  const held = new URLSearchParams(location.hash.slice(1)), found = {};
  for (const key of KEPT) if (held.has(key)) found[key] = typeof state[key] === "number" ? Number(held.get(key)) : held.get(key);
  return found;
}

/** What of an address still fits this page. */
function valid(found) {
  if (found.run !== undefined && !data.runs[found.run]) return {};
  const ours = data.runs[found.run ?? 0], known = [REFERENCE, ...ours.methods.map((one) => one.name)];
  const bad = (key) => found[key] !== undefined && ((["a", "b"].includes(key) && !known.includes(found[key])) ||
    (key === "frame" && !ours.frames[found.frame]) || (key === "view" && !VIEWS[found.view]) || Number.isNaN(found[key]));
  return Object.fromEntries(Object.entries(found).filter(([key]) => !bad(key)));
}

function start() {
  $("old").hidden = "DecompressionStream" in window;
  $("hold").checked = matchMedia("(prefers-reduced-motion: reduce)").matches;
  fill($("run"), data.runs.map((one, i) => i), (i) => data.runs[i].title);
  $("run").parentElement.hidden = data.runs.length < 2;
  const found = valid(recalled());
  state.run = found.run ?? 0;
  entered();
  set(found);
  drawCurves();
  drawScatter();
  drawLegend();
  addEventListener("hashchange", () => {
    const asked = valid(recalled());
    set({ run: asked.run ?? state.run });
    set(asked);
  });
  let width = innerWidth;
  addEventListener("resize", () => {
    invalidate();
    if (innerWidth === width) return;
    width = innerWidth;
    drawCurves();
    drawScatter();
    drawLegend();
  });
}

if (data.runs.length) start();
