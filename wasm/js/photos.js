/** Reads photos from files: a program of its own, which onescan.js loads with the first of them. */

import { beside } from './files.js';
import init, { decode as read } from './wasm/onescan_photos.js';

/** @type {Promise<unknown> | undefined} */
let program;

/** Loads the program. */
export async function load() {
  program ??= beside(new URL('./wasm/onescan_photos_bg.wasm', import.meta.url)).then((source) => init({ module_or_path: source }));
  await program.catch((error) => {
    program = undefined; // The next photo tries again.
    throw error;
  });
}

/** The pixels of a PNG or JPEG. @param {Uint8Array} bytes */
export async function decode(bytes) {
  await load();
  const photo = read(bytes);
  const { width, height } = photo;
  return { width, height, rgb: photo.intoRgb() };
}
