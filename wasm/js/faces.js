/** Finds faces and their landmarks: a program of its own, which onescan.js loads when asked to. */

import { beside, bytes } from './files.js';
import init, { Detector as Networks } from './wasm/onescan_faces.js';

/** @typedef {import('./onescan.js').Landmark} Landmark */
/** @typedef {{ x: number, y: number, size: number, landmarks: Landmark[] }} Face Centre and longer side of its box in the photo, pixels, and its landmarks. */

const NETWORKS = ['face_detection_short_range', 'face_landmark'];

/** Loads the program and its networks from beside this file. */
export async function load() {
  const program = await beside(new URL('./wasm/onescan_faces_bg.wasm', import.meta.url));
  const urls = NETWORKS.map((name) => new URL(`./face_mesh/${name}.tflite`, import.meta.url));
  const [[detector, mesh]] = await Promise.all([Promise.all(urls.map(bytes)), init({ module_or_path: program })]);
  return new Detector(new Networks(detector, mesh));
}

export class Detector {
  #networks;

  /** @param {Networks} networks */
  constructor(networks) {
    this.#networks = networks;
  }

  /**
   * The faces of a photo, the largest first.
   * @param {import('./onescan.js').Photo} photo
   * @returns {Face[]}
   */
  faces(photo) {
    return this.#networks.faces(photo.width, photo.height, photo.rgb()).map((face) => {
      const lines = face.landmarks.trim().split('\n').map((line) => line.split(' '));
      const landmarks = lines.map(([name, , x, y]) => ({ name, x: Number(x), y: Number(y) }));
      const { x, y, size } = face;
      face.free();
      return { x, y, size, landmarks };
    });
  }

  free() {
    this.#networks.free();
  }
}
