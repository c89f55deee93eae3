// Fits a case in WebAssembly by the C library's functions, by a chain and by a search, and prints
// their fingerprints:
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
  const plain = header.replace(/\/\*[^]*?\*\//g, "");
  const [, body] = new RegExp(`typedef struct \\{([^{}]*)\\} ${name};`).exec(plain);
  const sizes = { uint64_t: 8, double: 8, uint32_t: 4, float: 4, uint8_t: 1, bool: 1 };
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

const header = readFileSync(new URL("../../c/include/onescan.h", import.meta.url), "utf8");
const constant = (name) => Number(new RegExp(`#define ${name} (\\d+)`).exec(header)[1]);
function number(name, at, field) {
  const { type, offset } = layout(name).of[field];
  const get = { uint32_t: "getUint32", uint64_t: "getBigUint64", float: "getFloat32", bool: "getUint8" }[type];
  return view()[get](at + offset, true);
}

const model = readFileSync(join(place, "face.3dmm"));
const modelAt = put(model);
const info = allocate(layout("OnescanModelInfo").size);
check(onescan.onescan_model_info(modelAt, model.length, info), "model");
const fields = layout("OnescanSettings");
const settings = allocate(fields.size);
onescan.onescan_default_settings(settings);
function set(name, value) {
  const { type, offset } = fields.of[name];
  view()[{ uint32_t: "setUint32", float: "setFloat32" }[type]](settings + offset, value, true);
}
function setRanks(rank) {
  set("shape_rank", rank);
  set("albedo_rank", rank);
}
if (small) {
  setRanks(30);
  set("landmark_samples", 1000);
  set("samples", 2000);
  set("landmark_sd", 1);
  set("pixel_patch", 5);
}

// Functions called PREFIX_start and so on; what they fit in takes `length` words of eight bytes.
function fit(prefix, length, progressName, photoName) {
  const photo = readFileSync(join(place, `${photoName}.ppm`));
  const [head, width, height] = /^P6\n(\d+) (\d+)\n255\n/.exec(photo.toString("latin1"));
  const rgbAt = put(photo.subarray(head.length));
  const lines = readFileSync(join(place, `${photoName}.tlms`), "utf8").trim().split("\n");
  const names = lines.map((line) => put(new TextEncoder().encode(`${line.split(" ")[0]}\0`)));
  const landmarks = allocate(12 * lines.length);
  lines.forEach((line, i) => {
    const [, , x, y] = line.split(" ");
    view().setUint32(landmarks + 12 * i, names[i], true);
    view().setFloat32(landmarks + 12 * i + 4, Number(x), true);
    view().setFloat32(landmarks + 12 * i + 8, Number(y), true);
  });
  const words = onescan[`${prefix}_words`](info, settings, lines.length, width, height);
  const room = allocate(4 * words);
  const running = allocate(8 * length);
  check(
    onescan[`${prefix}_start`](
      running, modelAt, model.length, rgbAt, width, height, landmarks, lines.length, settings, room, words,
    ),
    "start",
  );
  while (onescan[`${prefix}_step`](running, 500) > 0) {}
  const progress = allocate(layout(progressName).size);
  check(onescan[`${prefix}_progress`](running, progress), "progress");
  return number(progressName, progress, "fingerprint").toString(16).padStart(16, "0");
}

// The paper's chain: one pixel, one error.
const patch = view().getFloat32(settings + fields.of.pixel_patch.offset, true);
if (!small) set("pixel_patch", 1);
console.log(`fingerprint ${fit("onescan", constant("ONESCAN_FIT_LENGTH"), "OnescanProgress", "photo")}`);
set("pixel_patch", patch);
if (small) setRanks(20);
const half = small ? "half" : "photo";
console.log(`search ${fit("onescan_search", constant("ONESCAN_SEARCH_LENGTH"), "OnescanSearchProgress", half)}`);
