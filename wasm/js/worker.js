/** The other end of client.js: one model, its photos, one fit and one viewer, in a worker. */

import { create } from './onescan.js';

/** @typedef {import('./onescan.js').Landmarks} Landmarks */
/** @typedef {import('./onescan.js').Settings} Settings */
/** @typedef {import('./onescan.js').Progress} Progress */
/** @typedef {{ vertices: number, shapeRank: number, albedoRank: number, landmarks: string[], provenance: string }} ModelFacts */
/** @typedef {{ width: number, height: number, picture: ImageBitmap }} PhotoFacts */
/** @typedef {{ overlay: ImageBitmap, behind: ImageBitmap, mask: ImageBitmap }} LivePictures The face over the photo, the same behind what hides it, and the mask. */
/** @typedef {Progress & { trace: import('./onescan.js').TracePoint[], levels: import('./onescan.js').Level[], photo: number, crop: number[], pictures?: LivePictures }} LiveProgress The pictures are of the photo of this number: of the one that is watched, and at the end of all. */
/** @typedef {{ yaw: number, pitch: number, width: number, height: number, ground: number, fine?: boolean }} Camera Fine: with smooth edges, which takes longer. */
/** @typedef {{ shape: Float32Array, albedo: Float32Array }} Coefficients */

/** Longest side of the photo that is sent to be shown, pixels. */
const SHOWN = 1600;

const program = create();
/** @type {import('./onescan.js').Model | undefined} */
let model;
/** Of one person. @type {import('./onescan.js').Photo[]} */
let photos = [];
/** Which of them is watched while a fit runs. */
let watched = 0;
/** Sends pictures of a photo as the running fit has it. @type {((photo: number) => void) | undefined} */
let send;
/** @type {import('./onescan.js').Fit | undefined} */
let fit;
/** @type {import('./onescan.js').Fitted | undefined} */
let fitted;
/** @type {import('./onescan.js').Viewer | undefined} */
let viewer;
/** @type {Promise<import('./faces.js').Detector> | undefined} */
let detector;

/**
 * What is needed, or a message.
 * @template T
 * @param {T | undefined} value
 * @param {string} what
 * @returns {T}
 */
function need(value, what) {
  if (value === undefined) throw new Error(`no ${what} yet`);
  return value;
}

/** @param {import('./wasm/onescan_wasm.js').Pixels} pixels */
async function bitmap(pixels) {
  const rgba = new Uint8ClampedArray(pixels.rgba());
  const image = new ImageData(rgba, pixels.width, pixels.height);
  pixels.free();
  return createImageBitmap(image);
}

/** @param {import('./wasm/onescan_wasm.js').File[]} files */
function unpack(files) {
  return files.map((file) => ({ name: file.name, bytes: new Uint8Array(file.bytes) }));
}

/** @param {import('./onescan.js').Photo} photo @returns {Promise<PhotoFacts>} */
async function facts(photo) {
  const { width, height } = photo;
  return { width, height, picture: await bitmap(photo.shown(SHOWN)) };
}

/** @returns {Coefficients} */
function coefficients() {
  const { shape, albedo } = need(viewer, 'model');
  return { shape, albedo };
}

const methods = {
  /** @param {Uint8Array} bytes @returns {Promise<ModelFacts>} */
  async open(bytes) {
    const onescan = await program;
    // Nothing of the old model goes before the new one is known to be good.
    const opened = onescan.model(bytes);
    const { vertices, shapeRank, albedoRank, landmarks, provenance } = opened;
    fitted?.free();
    viewer?.free();
    model?.free();
    fitted = undefined;
    model = opened;
    viewer = onescan.viewer(opened);
    // A photo is next: what reads it comes meanwhile.
    import('./photos.js').then(({ load }) => load()).catch(() => {});
    return { vertices, shapeRank, albedoRank, landmarks, provenance };
  },

  /** The photo, instead of what there was. @param {Uint8Array | ImageData} source */
  async photo(source) {
    const taken = await (await program).photo(source);
    for (const old of photos) old.free();
    photos = [taken];
    watched = 0;
    return facts(taken);
  },

  /** One more photo of the same person. @param {Uint8Array | ImageData} source */
  async addPhoto(source) {
    const taken = await (await program).photo(source);
    photos.push(taken);
    return facts(taken);
  },

  /** @param {number} at Its number, from 0. */
  removePhoto(at) {
    for (const old of photos.splice(at, 1)) old.free();
    watched = 0;
  },

  /** The faces of a photo, the largest first. @param {number} at Its number. */
  async faces(at) {
    const onescan = await program;
    detector ??= onescan.detector();
    const found = await detector.catch((error) => {
      detector = undefined; // The next call tries again.
      throw error;
    });
    return found.faces(need(photos[at], 'such photo'));
  },

  /** Of several photos, which is seen while a fit runs. @param {number} at Its number. */
  watch(at) {
    need(photos[at], 'such photo');
    watched = at;
    if (fit && at < fit.photos) send?.(at);
  },

  /**
   * Fits to all photos. Of several, `landmarks`, `names.photo` and in the result `summary` are arrays.
   * @param {{ landmarks: Landmarks | Landmarks[], names: { model: string, photo: string | string[] }, live?: boolean } & Settings} job
   */
  async fit({ landmarks, names, live = true, ...settings }) {
    const onescan = await program;
    if (fit) throw new Error('a fit is running');
    const one = need(photos[0], 'photo');
    const shown = /** @type {import('./onescan.js').Shown} */ ({ photo: photos[1] ? photos : one, landmarks });
    const running = onescan.fit({ model: need(model, 'model'), ...shown, ...settings });
    fit = running;
    const { levels } = onescan;
    send = async (photo) => {
      const progress = { ...running.progress, trace: running.trace, levels, photo, crop: running.crop(photo) };
      if (!live) return tell(progress, []);
      const drawn = [running.overlay({ photo }), running.overlay({ photo, behind: true }), running.mask(photo)];
      const [overlay, behind, mask] = await Promise.all(drawn.map(bitmap));
      tell({ ...progress, pictures: { overlay, behind, mask } }, [overlay, behind, mask]);
    };
    running.addEventListener('progress', () => {
      const { ended } = running.progress;
      for (const photo of Array(running.photos).keys()) if (ended || photo === watched) send?.(photo);
    });
    try {
      if (!(await running.run())) {
        running.free();
        return undefined;
      }
    } finally {
      fit = send = undefined;
    }
    const { progress, fingerprint } = running;
    if (!live) {
      running.free();
      return { fingerprint, progress };
    }
    fitted?.free();
    const made = running.finish(names);
    fitted = made;
    const summaries = Array.from({ length: running.photos }, (_, i) => JSON.parse(made.json(i)));
    need(viewer, 'model').adopt(made);
    return { fingerprint, progress, summary: summaries[1] ? summaries : summaries[0], ...coefficients() };
  },

  pause() {
    fit?.pause();
  },

  resume() {
    fit?.resume();
  },

  cancel() {
    fit?.cancel();
  },

  /** The files of the finished fit. */
  fitFiles() {
    return unpack(need(fitted, 'fit').files());
  },

  /** @param {Camera} camera */
  async draw({ width, height, yaw, pitch, ground, fine = false }) {
    return bitmap(need(viewer, 'model').draw(width, height, yaw, pitch, ground, fine));
  },

  /** Draws the mean, whatever is shown. @param {Camera} camera */
  async drawMean({ width, height, yaw, pitch, ground }) {
    const mean = (await program).viewer(need(model, 'model'));
    const picture = await bitmap(mean.draw(width, height, yaw, pitch, ground, true));
    mean.free();
    return picture;
  },

  /** @param {Camera} camera */
  png({ width, height, yaw, pitch, ground }) {
    const pixels = need(viewer, 'model').draw(width, height, yaw, pitch, ground, true);
    const bytes = new Uint8Array(pixels.png());
    pixels.free();
    return bytes;
  },

  /** Where a landmark of the mean is in a picture. @param {string} name @param {Camera} camera */
  locate(name, { width, height, yaw, pitch }) {
    return [...need(viewer, 'model').locate(name, width, height, yaw, pitch)];
  },

  /** @param {Coefficients} values */
  set({ shape, albedo }) {
    need(viewer, 'model').set(shape, albedo);
  },

  /** @param {number} seed */
  random(seed) {
    need(viewer, 'model').random(seed);
    return coefficients();
  },

  mean() {
    need(viewer, 'model').set(new Float32Array(), new Float32Array());
    return coefficients();
  },

  fitted() {
    need(viewer, 'model').adopt(need(fitted, 'fit'));
    return coefficients();
  },

  /** Lays the photos' colours on the fitted face, whatever its shape, or takes them off. @param {boolean} on */
  dress(on) {
    const view = need(viewer, 'model');
    if (on) view.dress(need(fitted, 'fit'));
    else view.undress();
  },

  /** @param {string} name `photo` is the light of a photo of the finished fit. @param {number} [photo] Its number. */
  light(name, photo) {
    const view = need(viewer, 'model');
    if (name === 'photo') view.illuminateAs(need(fitted, 'fit'), photo);
    else view.illuminate(name);
  },

  /** The face that is shown. */
  files() {
    return unpack(need(viewer, 'model').files());
  },
};

/** @typedef {typeof methods} Methods */

/**
 * @param {LiveProgress} progress
 * @param {Transferable[]} transfer
 */
function tell(progress, transfer) {
  postMessage({ progress }, { transfer });
}

/** What need not be copied. @param {unknown} value @returns {Transferable[]} */
function transferable(value) {
  if (value instanceof ImageBitmap) return [value];
  if (value instanceof Uint8Array) return [/** @type {ArrayBuffer} */ (value.buffer)];
  if (typeof value !== 'object' || value === null) return [];
  return Object.values(value).flatMap((part) => (typeof part === 'object' ? transferable(part) : []));
}

addEventListener('message', async ({ data: { id, method, args } }) => {
  try {
    const call = /** @type {(...args: unknown[]) => unknown} */ (methods[/** @type {keyof Methods} */ (method)]);
    const value = await call(...args);
    postMessage({ id, value }, { transfer: transferable(value) });
  } catch (error) {
    postMessage({ id, error: error instanceof Error ? error.message : String(error) });
  }
});
