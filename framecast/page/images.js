// Images: text in the page -> codes -> display pixels. The twin of packing.py and of color.to_display.

const data = JSON.parse(document.getElementById("data").textContent);
const coding = data.coding;

/** Linear value of a code. */
const linearOf = (code) => (2 ** (code / coding.steps) - 1) / coding.floor;

/** A linear value as shown, 0..1: highlights compressed above 0.8, then sRGB. */
function display(linear) {
  const x = linear <= 0.8 ? linear : 1 - 0.2 * Math.exp((0.8 - linear) / 0.2);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
}

/** Display bytes of every code at an exposure in stops. */
function curve(stops) {
  const codes = Math.round(coding.steps * Math.log2(1 + coding.floor * coding.brightest)) + 1;
  return Uint8Array.from({ length: codes }, (_, code) => Math.round(255 * display(linearOf(code) * 2 ** stops)));
}

/** Colours of 0..255 from black through violet and orange to pale yellow, of rising lightness. */
const HEAT = (() => {
  const stops = [[8, 8, 16], [48, 24, 112], [128, 32, 136], [208, 64, 104], [248, 128, 64], [252, 200, 96], [255, 252, 216]];
  return Array.from({ length: 256 }, (_, i) => {
    const at = (i / 255) * (stops.length - 1), k = Math.min(Math.floor(at), stops.length - 2);
    return stops[k].map((low, c) => Math.round(low + (stops[k + 1][c] - low) * (at - k)));
  });
})();

const decoded = new Map();
const loading = new Map();

/** The image of an id if it is decoded, else undefined, and `then` is called when it is. */
function image(id, then) {
  if (decoded.has(id)) return decoded.get(id);
  if (!loading.has(id)) loading.set(id, load(id).then((made) => decoded.set(id, made)));
  if (then) loading.get(id).then(then);
}

async function load(id) {
  const element = document.getElementById(id);
  const [width, height, planes] = element.dataset.size.split(" ").map(Number);
  const packed = Uint8Array.from(atob(element.textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  return { id, width, height, planes: unpack(bytes, width, height, planes) };
}

/** Planes of codes; see packing.pack. */
function unpack(bytes, width, height, count) {
  const size = width * height, high = size * count;
  const planes = Array.from({ length: count }, () => new Int16Array(size));
  planes.forEach((plane, p) => {
    for (let y = 0, i = 0; y < height; y++) {
      for (let x = 0; x < width; x++, i++) {
        const a = x ? plane[i - 1] : 0, b = y ? plane[i - width] : 0;
        let guess = a + b;
        if (x && y) {
          const c = plane[i - width - 1], low = a < b ? a : b, top = a < b ? b : a;
          guess = c >= top ? low : c <= low ? top : guess - c;
        }
        const u = bytes[p * size + i] | (bytes[high + p * size + i] << 8);
        plane[i] = guess + ((u >>> 1) ^ -(u & 1));
      }
    }
  });
  if (count === 3) {
    const [green, red, blue] = planes;
    for (let i = 0; i < size; i++) {
      red[i] += green[i];
      blue[i] += green[i];
    }
    return [red, green, blue];
  }
  return planes;
}

const bitmaps = new Map();
const MEMORY = 256e6;
let held = 0;

/** A canvas that shows what `paint(pixels, size)` makes of an image's size; kept until memory is short. */
function bitmap(key, like, paint) {
  let canvas = bitmaps.get(key);
  if (canvas) {
    bitmaps.delete(key);
  } else {
    canvas = Object.assign(document.createElement("canvas"), { width: like.width, height: like.height });
    const context = canvas.getContext("2d");
    const pixels = context.createImageData(like.width, like.height);
    paint(pixels.data, like.width * like.height);
    context.putImageData(pixels, 0, 0);
    held += 4 * like.width * like.height;
  }
  bitmaps.set(key, canvas);
  for (const [old, other] of bitmaps) {
    if (held <= MEMORY || old === key) break;
    held -= 4 * other.width * other.height;
    bitmaps.delete(old);
  }
  return canvas;
}

/** An image at an exposure. */
function picture(shown, stops) {
  return bitmap(`${shown.id} ${stops}`, shown, (out, size) => {
    const table = curve(stops), [red, green, blue] = shown.planes;
    for (let i = 0; i < size; i++) {
      out[4 * i] = table[red[i]];
      out[4 * i + 1] = table[green[i]];
      out[4 * i + 2] = table[blue[i]];
      out[4 * i + 3] = 255;
    }
  });
}

/** The mean difference of two images over the channels, as shown at an exposure, times a gain, in heat colours. */
function difference(one, other, stops, gain) {
  return bitmap(`${one.id} ${other.id} ${stops} ${gain}`, one, (out, size) => {
    const table = curve(stops);
    const away = (c, i) => Math.abs(table[one.planes[c][i]] - table[other.planes[c][i]]);
    heat(out, size, (i) => ((away(0, i) + away(1, i) + away(2, i)) / 3) * gain);
  });
}

/** A map of bytes times a gain, in heat colours. */
function heatmap(shown, gain) {
  return bitmap(`${shown.id} heat ${gain}`, shown, (out, size) => heat(out, size, (i) => shown.planes[0][i] * gain));
}

function heat(out, size, level) {
  for (let i = 0; i < size; i++) {
    const [red, green, blue] = HEAT[Math.min(255, Math.round(level(i)))];
    out[4 * i] = red;
    out[4 * i + 1] = green;
    out[4 * i + 2] = blue;
    out[4 * i + 3] = 255;
  }
}
