// The stage: which tiles it shows, where each pixel of an image lies on it, and what the pointer does there.

const VIEWS = {
  wipe: "Wipe", side: "Side by side", all: "All", flicker: "Flicker", difference: "Difference", flip: "FLIP", slice: "x–t slice",
};
const REFERENCE = "reference";
const NARROW = 640; // width of the page below which the slices stand under the picture, not beside it
const NUMBERS_FROM = 42; // device-independent pixels for one image pixel, from which values fit into it

const state = {
  run: 0, view: "wipe", a: "", b: "", frame: 0, wipe: 0.5, zoom: 0, x: 0, y: 0, exposure: 0, gain: 1, row: 0,
  swapped: false, playing: false, speed: 1, metric: "", region: "all",
};

const stage = document.getElementById("stage");
const ink = stage.getContext("2d");
let pointer = null; // over the stage, in its device pixels
let drawing = false;

const run = () => data.runs[state.run];
const names = () => [...(run().reference ? [REFERENCE] : []), ...run().methods.map((m) => m.name)];
const method = (name) => run().methods.find((m) => m.name === name);
const imageId = (name, frame = state.frame) => (name === REFERENCE ? run().reference : method(name).images)[frame];
const color = (name) =>
  name === REFERENCE ? "var(--ink)" : `var(--m${run().methods.findIndex((m) => m.name === name) % 8})`;

/** Draws soon, once; until then the page says that it waits. */
function invalidate() {
  document.body.dataset.waiting = "";
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => {
    drawing = false;
    draw();
  });
}

/** What the stage holds: for each tile the images that it needs and how they become canvases. */
function tiles() {
  const plain = (name) => ({ label: name, ids: [imageId(name)], paint: ([shown]) => picture(shown, state.exposure) });
  const [a, b] = [state.a, state.b];
  switch (state.view) {
    case "side": return [plain(a), plain(b)];
    case "all": return names().map(plain);
    case "flicker": return [plain(state.swapped ? b : a)];
    case "difference": return [{
      label: `|${a} − ${b}| × ${state.gain}`, ids: [imageId(a), imageId(b)],
      paint: ([one, other]) => difference(one, other, state.exposure, state.gain),
    }];
    case "flip": {
      const judged = [a, b].filter((name) => name !== REFERENCE);
      return judged.map((name) => {
        const id = method(name).flip[state.frame];
        const scored = `FLIP of ${name}${state.gain > 1 ? ` × ${state.gain}` : ""}`;
        if (id) return { label: scored, ids: [id], paint: ([map]) => heatmap(map, state.gain) };
        const why = imageId(name) && imageId(name) === imageId(REFERENCE) ? "equal to the reference" : "not compared";
        return { label: `${scored}: ${why}`, ids: [imageId(name)], paint: ([shown]) => heatmap(blank(shown), 1) };
      });
    }
    default: return [plain(a), plain(b)];
  }
}

const blank = (like) => ({ ...like, id: `blank ${like.width}x${like.height}`, planes: [new Uint8Array(like.width * like.height)] });
const overlaid = () => state.view === "wipe" || (state.view === "flip" && tiles().length === 2);

/** Columns, rows and tile size that show `count` images largest, in device pixels. */
function layout(count) {
  const [height, width] = run().size, density = devicePixelRatio || 1;
  const room = Math.max(240, stage.parentElement.clientWidth);
  if (state.view === "slice" && room < NARROW) return { columns: 1, rows: 1, w: Math.floor(room * density), h: Math.floor(1.25 * room * density) };
  const cap = Math.max(240, innerHeight * (state.view === "all" ? 0.85 : 0.66));
  let best = { scale: 0 };
  for (let columns = count; columns >= 1; columns--) { // rather columns than rows, where it makes little difference
    const rows = Math.ceil(count / columns), h = Math.min((room / columns / width) * height, cap / rows), scale = h / height;
    const w = count === 1 ? room : scale * width;
    if (scale > 1.08 * best.scale) best = { columns, rows, w: Math.floor(w * density), h: Math.floor(h * density), scale };
  }
  return best;
}

const fit = (w, h) => Math.min(w / run().size[1], h / run().size[0]);
const scaleIn = (w, h) => state.zoom || fit(w, h);

/** Where image position (0, 0) lies in a tile of w by h, and the scale; an image smaller than the tile is centred. */
function placed(w, h) {
  const [height, width] = run().size, scale = scaleIn(w, h);
  const along = (centre, size, room) => {
    if (size * scale <= room) return (room - size * scale) / 2;
    return Math.min(0, Math.max(room - size * scale, room / 2 - centre * scale));
  };
  return { scale, left: along(state.x, width, w), top: along(state.y, height, h) };
}

let shape = { columns: 1, rows: 1, w: 1, h: 1 };

function draw() {
  const found = state.view === "slice" ? sliceTiles() : tiles();
  const images = found.map((tile) => tile.ids.map((id) => id && image(id, invalidate)));
  if (images.flat().includes(undefined)) return; // drawn when they are there
  shape = layout(overlaid() || state.view === "slice" ? 1 : found.length);
  resize(shape.columns * shape.w, shape.rows * shape.h);
  ink.fillStyle = "#17181b";
  ink.fillRect(0, 0, stage.width, stage.height);
  if (state.view === "slice") drawSlices(found, images);
  else if (overlaid()) drawWipe(found, images);
  else found.forEach((tile, i) => drawTile(tile, images[i], (i % shape.columns) * shape.w, Math.floor(i / shape.columns) * shape.h));
  drawn();
}

function resize(width, height) {
  if (stage.width !== width || stage.height !== height) {
    stage.width = width;
    stage.height = height;
    stage.style.height = `${height / (devicePixelRatio || 1)}px`;
  }
}

function drawTile(tile, images, left, top) {
  clipped(left, top, shape.w, shape.h, () => drawImage(tile, images, left, top));
  label(tile.label, left + 8, top + 8, "left");
}

function drawImage(tile, images, left = 0, top = 0) {
  const at = placed(shape.w, shape.h), canvas = tile.paint(images);
  ink.imageSmoothingEnabled = at.scale < 1 || !state.zoom;
  ink.imageSmoothingQuality = "high";
  ink.drawImage(canvas, left + at.left, top + at.top, canvas.width * at.scale, canvas.height * at.scale);
  if (at.scale >= NUMBERS_FROM * (devicePixelRatio || 1)) drawNumbers(images[0], at, left, top);
}

function drawWipe(found, images) {
  const split = Math.round(state.wipe * stage.width), density = devicePixelRatio || 1;
  clipped(0, 0, split, stage.height, () => drawImage(found[0], images[0]));
  clipped(split, 0, stage.width - split, stage.height, () => drawImage(found[1], images[1]));
  ink.fillStyle = "rgb(0 0 0 / 55%)";
  ink.fillRect(split - 2 * density, 0, 4 * density, stage.height);
  ink.fillStyle = "#fff";
  ink.fillRect(split - density, 0, 2 * density, stage.height);
  ink.beginPath();
  ink.arc(split, stage.height / 2, 13 * density, 0, 7);
  ink.shadowColor = "rgb(0 0 0 / 60%)";
  ink.shadowBlur = 6 * density;
  ink.fill();
  ink.shadowBlur = 0;
  ink.fillStyle = "#222";
  for (const side of [-1, 1]) {
    ink.beginPath();
    ink.moveTo(split + side * 9 * density, stage.height / 2);
    ink.lineTo(split + side * 4 * density, stage.height / 2 - 4.5 * density);
    ink.lineTo(split + side * 4 * density, stage.height / 2 + 4.5 * density);
    ink.fill();
  }
  label(found[0].label, 8, 8, "left");
  label(found[1].label, stage.width - 8, 8, "right");
}

function clipped(x, y, w, h, paint) {
  ink.save();
  ink.beginPath();
  ink.rect(x, y, w, h);
  ink.clip();
  paint();
  ink.restore();
}

/** A name in a corner; x and y are its outer corner. */
function label(text, x, y, side) {
  const density = devicePixelRatio || 1;
  ink.font = `600 ${12.5 * density}px system-ui, sans-serif`;
  ink.textBaseline = "middle";
  ink.textAlign = "left";
  const width = ink.measureText(text).width + 16 * density, left = side === "right" ? x - width : x;
  ink.fillStyle = "rgb(20 21 24 / 82%)";
  ink.beginPath();
  ink.roundRect(left, y, width, 24 * density, 6 * density);
  ink.fill();
  ink.fillStyle = "#fff";
  ink.fillText(text, left + 8 * density, y + 12.5 * density);
}

/** Linear red, green and blue written into each pixel on show. */
function drawNumbers(shown, at, left, top) {
  if (shown.planes.length !== 3) return;
  const density = devicePixelRatio || 1, table = curve(state.exposure);
  ink.font = `${11 * density}px ui-monospace, monospace`;
  ink.textAlign = "center";
  ink.textBaseline = "middle";
  const x0 = Math.max(0, Math.floor(-at.left / at.scale)), y0 = Math.max(0, Math.floor(-at.top / at.scale));
  for (let y = y0; y < shown.height && at.top + y * at.scale < shape.h; y++) {
    for (let x = x0; x < shown.width && at.left + x * at.scale < shape.w; x++) {
      const i = y * shown.width + x, light = shown.planes.reduce((sum, plane, c) => sum + table[plane[i]] * [0.3, 0.6, 0.1][c], 0);
      ink.fillStyle = light > 128 ? "#000" : "#fff";
      shown.planes.forEach((plane, c) =>
        ink.fillText(
          value(linearOf(plane[i])), left + at.left + (x + 0.5) * at.scale,
          top + at.top + (y + 0.5) * at.scale + (c - 1) * 12.5 * density,
        ));
    }
  }
}

/** A linear value in three digits. */
const value = (linear) => (linear >= 100 ? linear.toFixed(0) : linear >= 10 ? linear.toFixed(1) : linear >= 1 ? linear.toFixed(2) : linear.toFixed(3));

// The x-t slice: one row of the image in every frame, one below the other.

function sliceTiles() {
  const shown = [...new Set([state.a, state.b, ...(run().reference ? [REFERENCE] : [])])];
  const rows = shown.map((name) => ({ label: name, ids: run().frames.map((_, frame) => imageId(name, frame)) }));
  return [{ label: state.a, ids: [imageId(state.a)], paint: ([one]) => picture(one, state.exposure) }, ...rows];
}

/** Parts of the stage: the frame above (or left of) the slices. */
function sliceShape(count) {
  const [height, width] = run().size, wide = stage.width >= NARROW * (devicePixelRatio || 1);
  const frame = wide ? { w: Math.round(stage.width * 0.42), h: stage.height } : { w: stage.width, h: Math.round(stage.height * 0.4) };
  const scale = Math.min(frame.w / width, frame.h / height);
  const room = wide ? { x: frame.w, y: 0, w: stage.width - frame.w, h: stage.height } : { x: 0, y: frame.h, w: stage.width, h: stage.height - frame.h };
  return { frame, scale, left: (frame.w - width * scale) / 2, top: (frame.h - height * scale) / 2, room, strip: room.h / count };
}

function drawSlices([first, ...rows], images) {
  const density = devicePixelRatio || 1, at = sliceShape(rows.length), row = Math.min(state.row, images[0][0].height - 1);
  const canvas = first.paint(images[0]);
  ink.imageSmoothingEnabled = true;
  ink.drawImage(canvas, at.left, at.top, canvas.width * at.scale, canvas.height * at.scale);
  ink.fillStyle = "#ffb000";
  ink.fillRect(at.left, at.top + (row + 0.5) * at.scale - density, canvas.width * at.scale, 2 * density);
  label(`${first.label}, row ${row + run().window[1]}`, 8, 8, "left");
  rows.forEach((strip, k) => {
    const gap = 6 * density, left = at.room.x + gap, top = at.room.y + k * at.strip + gap;
    const w = at.room.w - 2 * gap, h = at.strip - 2 * gap, each = h / strip.ids.length;
    ink.imageSmoothingEnabled = each < 1;
    images[k + 1].forEach((shown, frame) =>
      ink.drawImage(picture(shown, state.exposure), 0, row, shown.width, 1, left, top + frame * each, w, each + 0.5));
    ink.fillStyle = "#ffb000";
    ink.fillRect(left - gap, top + state.frame * each, gap - density, each);
    label(strip.label, left + 6, top + 6, "left");
  });
}

// From the stage to the image and back.

/** Tile and image pixel under a point of the stage, or null beside the image. */
function under(point) {
  if (state.view === "slice") return null;
  const column = Math.floor(point.x / shape.w), line = Math.floor(point.y / shape.h), at = placed(shape.w, shape.h);
  const x = Math.floor((point.x - column * shape.w - at.left) / at.scale);
  const y = Math.floor((point.y - line * shape.h - at.top) / at.scale);
  return x >= 0 && y >= 0 && x < run().size[1] && y < run().size[0] ? { x, y } : null;
}

/** Zooms by a factor so that what lies under a point of the stage (its middle by default) stays there. */
function zoomBy(factor, point = { x: shape.w / 2, y: shape.h / 2 }) {
  const before = placed(shape.w, shape.h), x = point.x % shape.w, y = point.y % shape.h;
  const whole = fit(shape.w, shape.h), scale = Math.min(160 * (devicePixelRatio || 1), before.scale * factor);
  if (scale <= whole) return set({ zoom: 0 });
  const at = { x: (x - before.left) / before.scale, y: (y - before.top) / before.scale };
  set({ zoom: scale, x: at.x + (shape.w / 2 - x) / scale, y: at.y + (shape.h / 2 - y) / scale });
}

/** Moves the image by pixels of the stage. */
function pan(dx, dy) {
  const [height, width] = run().size, at = placed(shape.w, shape.h);
  const along = (left, size, room) => (size * at.scale <= room ? size / 2 : (room / 2 - left) / at.scale);
  set({ x: along(at.left + dx, width, shape.w), y: along(at.top + dy, height, shape.h) });
}

function local(event) {
  const box = stage.getBoundingClientRect(), density = stage.width / box.width;
  return { x: (event.clientX - box.left) * density, y: (event.clientY - box.top) * density };
}

const fingers = new Map();
let dragging = null; // "wipe", "pan", "row"

stage.addEventListener("pointerdown", (event) => {
  const point = local(event), density = devicePixelRatio || 1;
  fingers.set(event.pointerId, point);
  stage.setPointerCapture(event.pointerId);
  const near = Math.abs(point.x - state.wipe * stage.width) < 24 * density;
  dragging = state.view === "slice" ? "row" : overlaid() && (near || !state.zoom) ? "wipe" : "pan";
  if (fingers.size > 1) dragging = "pinch";
  drag(point, point);
});

stage.addEventListener("pointermove", (event) => {
  const point = local(event), before = fingers.get(event.pointerId);
  pointer = point;
  if (before) {
    if (dragging === "pinch") pinch(event.pointerId, before, point);
    else drag(before, point);
    fingers.set(event.pointerId, point);
  }
  probe();
});

for (const kind of ["pointerup", "pointercancel"]) stage.addEventListener(kind, (event) => {
  fingers.delete(event.pointerId);
  dragging = null;
});

stage.addEventListener("pointerleave", () => {
  pointer = null;
  probe();
});

stage.addEventListener("wheel", (event) => {
  if (!event.ctrlKey && document.activeElement !== stage) return; // else the page scrolls
  event.preventDefault();
  zoomBy(2 ** (-event.deltaY / 300), local(event));
}, { passive: false });

stage.addEventListener("dblclick", (event) => (state.zoom ? set({ zoom: 0 }) : zoomBy(4, local(event))));

function drag(before, point) {
  if (dragging === "wipe") set({ wipe: Math.min(1, Math.max(0, point.x / stage.width)) });
  if (dragging === "pan" && state.zoom) pan(point.x - before.x, point.y - before.y);
  if (dragging === "row") {
    const at = sliceShape(sliceTiles().length - 1), inside = point.x < at.frame.w && point.y < at.frame.h;
    if (inside) set({ row: Math.min(run().size[0] - 1, Math.max(0, Math.floor((point.y - at.top) / at.scale))) });
    else set({ frame: sliceFrame(point, at) });
  }
}

/** The frame of the line of a slice under a point. */
function sliceFrame(point, at) {
  const gap = 6 * (devicePixelRatio || 1), inStrip = ((point.y - at.room.y) % at.strip) - gap;
  const count = run().frames.length;
  return Math.min(count - 1, Math.max(0, Math.floor((inStrip / (at.strip - 2 * gap)) * count)));
}

function pinch(id, before, point) {
  const other = [...fingers].find(([key]) => key !== id)?.[1];
  if (!other) return;
  const apart = (p) => Math.hypot(p.x - other.x, p.y - other.y);
  zoomBy(apart(point) / Math.max(1, apart(before)), { x: (point.x + other.x) / 2, y: (point.y + other.y) / 2 });
}
