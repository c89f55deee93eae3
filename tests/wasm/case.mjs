// Fits a case in WebAssembly by the C library's functions and prints its fingerprint:
// node case.mjs LIBRARY.wasm CASE_DIRECTORY [small]
// by default settings, or by those of tests/case.
import { readFileSync } from "node:fs";
import { join } from "node:path";

const [library, place, small] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(readFileSync(library), {});
const { memory, ...onescan } = instance.exports;

// Memory of ours: pages beyond the library's.
let free = 0;
let end = 0;
function allocate(bytes) {
  free = (free + 7) & ~7;
  if (free + bytes > end) {
    const pages = Math.ceil(bytes / 65536) + 1;
    const start = memory.grow(pages) * 65536;
    if (start !== end) free = start;
    end = start + pages * 65536;
  }
  free += bytes;
  return free - bytes;
}
function put(bytes) {
  const at = allocate(bytes.length);
  new Uint8Array(memory.buffer).set(bytes, at);
  return at;
}
// Where a C compiler puts the fields of one of the header's structures.
function layout(name) {
  const header = readFileSync(new URL("../../c/include/onescan.h", import.meta.url), "utf8");
  const plain = header.replace(/\/\*[^]*?\*\//g, "");
  const [, body] = new RegExp(`typedef struct \\{([^{}]*)\\} ${name};`).exec(plain);
  const sizes = { uint64_t: 8, double: 8, uint32_t: 4, float: 4, bool: 1 };
  const of = {};
  let size = 0;
  for (const [, type, field] of body.matchAll(/(\w+) (\w+);/g)) {
    size = Math.ceil(size / sizes[type]) * sizes[type];
    of[field] = { type, offset: size };
    size += sizes[type];
  }
  return { of, size: Math.ceil(size / 8) * 8 };
}
const view = () => new DataView(memory.buffer);
const text = (at) => {
  const bytes = new Uint8Array(memory.buffer);
  return new TextDecoder().decode(bytes.slice(at, bytes.indexOf(0, at)));
};
function check(status, what) {
  if (status !== 0) throw new Error(`${what}: ${text(onescan.onescan_status_text(status))}`);
}

const model = readFileSync(join(place, "face.3dmm"));
const photo = readFileSync(join(place, "photo.ppm"));
const [header, width, height] = /^P6\n(\d+) (\d+)\n255\n/.exec(photo.toString("latin1"));
const rgb = photo.subarray(header.length);
const lines = readFileSync(join(place, "photo.tlms"), "utf8").trim().split("\n");

const modelAt = put(model);
const rgbAt = put(rgb);
const names = lines.map((line) => put(new TextEncoder().encode(`${line.split(" ")[0]}\0`)));
const landmarks = allocate(12 * lines.length);
lines.forEach((line, i) => {
  const [, , x, y] = line.split(" ");
  view().setUint32(landmarks + 12 * i, names[i], true);
  view().setFloat32(landmarks + 12 * i + 4, Number(x), true);
  view().setFloat32(landmarks + 12 * i + 8, Number(y), true);
});

const info = allocate(layout("OnescanModelInfo").size);
check(onescan.onescan_model_info(modelAt, model.length, info), "model");
const fields = layout("OnescanSettings");
const settings = allocate(fields.size);
onescan.onescan_default_settings(settings);
function set(name, value) {
  const { type, offset } = fields.of[name];
  view()[{ uint32_t: "setUint32", float: "setFloat32" }[type]](settings + offset, value, true);
}
if (small) {
  set("shape_rank", 30);
  set("albedo_rank", 30);
  set("landmark_samples", 1000);
  set("samples", 2000);
  set("landmark_sd", 1);
  set("pixel_patch", 5);
}

const words = onescan.onescan_words(info, settings, lines.length, width, height);
const room = allocate(4 * words);
const fit = allocate(8 * 3072);
check(
  onescan.onescan_start(
    fit, modelAt, model.length, rgbAt, width, height, landmarks, lines.length, settings, room, words,
  ),
  "start",
);
while (onescan.onescan_step(fit, 500) > 0) {}
const results = layout("OnescanProgress");
const progress = allocate(results.size);
check(onescan.onescan_progress(fit, progress), "progress");
const fingerprint = view().getBigUint64(progress + results.of.fingerprint.offset, true);
console.log(`fingerprint ${fingerprint.toString(16).padStart(16, "0")}`);
