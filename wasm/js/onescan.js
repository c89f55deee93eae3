/**
 * onescan in JavaScript: models, photos and fits in the thread that calls.
 *
 * In a page, a fit belongs into a worker: see `connect()` in client.js, which has the same names.
 */

/// <reference lib="esnext.disposable" preserve="true" />

import { beside } from './files.js';
import init, { Fit as Search, Model, Photo, Viewer } from './wasm/onescan_wasm.js';

export { Model, Photo, Viewer };

/** @typedef {{ name: string, x: number, y: number, visible?: boolean }} Landmark Pixels of the photo; pixel (x, y) is the point (x, y). */
/** @typedef {import('./faces.js').Face} Face */
/** @typedef {string | Landmark[]} Landmarks Of a photo; a string is the text of a `.tlms` file. */
/** @typedef {{ photo: Photo, landmarks: Landmarks } | { photo: Photo[], landmarks: Landmarks[] }} Shown A photo, or 2 to 8 of one person, each with its landmarks. */
/** @typedef {{ landmarkSd?: number, shapeRank?: number, albedoRank?: number, size?: number, pixelPatch?: number }} Settings As the options of `onescan fit --schedule mode`; ranks are the model's by default. */
/** @typedef {{ done: number, total: number, ended: boolean, converged: boolean, seconds: number, fingerprint: string }} Progress Steps done of at most so many in all. */
/** @typedef {{ blur: number, steps: number }} Level Standard deviation of the photo's blur, pixels of what the fit looks at, and the most steps. */
/** @typedef {{ level: number, energy: number }} TracePoint Before or after a step; energies of different levels measure different things. */
/** @typedef {{ name: string, bytes: Uint8Array<ArrayBuffer> }} SavedFile */
/** @typedef {import('./wasm/onescan_wasm.js').Fitted} Fitted */

/**
 * Loads the program.
 * @param {BufferSource | WebAssembly.Module | URL} [source] Where onescan_wasm_bg.wasm is; beside this file by default.
 */
export async function create(source) {
  await init({ module_or_path: source ?? (await beside(new URL('./wasm/onescan_wasm_bg.wasm', import.meta.url))) });
  return new Onescan();
}

/** What `create()` gives. */
export class Onescan {
  /**
   * A model of the bytes of a `.3dmm` file.
   * @param {Uint8Array} bytes
   */
  model(bytes) {
    if (!(bytes instanceof Uint8Array)) {
      throw new TypeError(`model() takes the bytes of a .3dmm file as a Uint8Array, not ${called(bytes)}`);
    }
    return new Model(bytes);
  }

  /**
   * A photo of the bytes of a PNG or JPEG, which another program reads, or of RGBA pixels.
   * @param {Uint8Array | { width: number, height: number, data: ArrayLike<number> }} source
   */
  async photo(source) {
    if (source instanceof Uint8Array) {
      const { decode } = await import('./photos.js');
      const { width, height, rgb } = await decode(source);
      return Photo.fromRgb(width, height, rgb);
    }
    if (!source?.data) {
      throw new TypeError(`photo() takes the bytes of a PNG or JPEG as a Uint8Array, or an ImageData, not ${called(source)}`);
    }
    return Photo.fromRgba(source.width, source.height, Uint8Array.from(source.data));
  }

  /**
   * Prepares a fit to a photo, or to several of one person: one face, and a view each.
   * @param {{ model: Model } & Shown & Settings} job
   */
  fit({ model, photo, landmarks, ...settings }) {
    const all = [photo].flat();
    if (!(model instanceof Model)) throw new TypeError(`fit() needs a model of model(), not ${called(model)}`);
    const other = all.findIndex((one) => !(one instanceof Photo));
    if (other >= 0) throw new TypeError(`fit() needs a photo of photo(), not ${called(all[other])}`);
    if (!landmarks) throw new TypeError('fit() needs landmarks: mark them, or take those of a face of detector()');
    // A search takes what it is given.
    const photos = all.map((one) => one.clone());
    const marked = /** @type {Landmarks[]} */ (Array.isArray(photo) ? [landmarks].flat() : [landmarks]);
    return new Fit(new Search(model, photos, marked.map(tlms), JSON.stringify(settings)), photos.length);
  }

  /** The levels of every fit, coarse to fine. @returns {Level[]} */
  get levels() {
    return levels();
  }

  /** What finds faces and their landmarks: loads another program and its networks, 1.5 MB. */
  async detector() {
    const { load } = await import('./faces.js');
    return load();
  }

  /**
   * A view of a model's faces.
   * @param {Model} model
   */
  viewer(model) {
    return new Viewer(model);
  }
}

/** What a wrong argument is, in words. @param {unknown} value */
function called(value) {
  if (value instanceof Promise) return 'a promise: await it';
  if (typeof value === 'string') return 'a string: read the file of that name first';
  return value === null || value === undefined ? 'nothing' : `a value of type ${value.constructor?.name ?? typeof value}`;
}

/** @returns {Level[]} */
function levels() {
  const numbers = [...Search.levels()];
  return Array.from({ length: numbers.length / 2 }, (_, i) => ({ blur: numbers[2 * i], steps: numbers[2 * i + 1] }));
}

/**
 * Landmarks as the text of a `.tlms` file.
 * @param {Landmarks} landmarks
 */
function tlms(landmarks) {
  if (typeof landmarks === 'string') return landmarks;
  const line = (/** @type {Landmark} */ { name, x, y, visible = true }) =>
    `${name} ${visible ? 1 : 0} ${x} ${y}\n`;
  return [landmarks].flat().map(line).join('');
}

/** A fit. Its photos count from 0. Fires `progress` after every call of `step()`. */
export class Fit extends EventTarget {
  /** None once it was finished or freed. @type {Search | undefined} */
  #kept;
  #seconds = 0;
  /** @type {'idle' | 'running' | 'paused' | 'cancelled'} */
  #state = 'idle';

  /** @param {Search} search @param {number} photos Their number. */
  constructor(search, photos) {
    super();
    this.#kept = search;
    this.photos = photos;
  }

  get #search() {
    if (!this.#kept) throw new Error('this fit is finished, and its memory given back; prepare another by fit()');
    return this.#kept;
  }

  /**
   * @overload
   * @param {'progress'} type
   * @param {(event: CustomEvent<Progress>) => void} listener
   * @param {AddEventListenerOptions} [options]
   * @returns {void}
   */
  /**
   * @overload
   * @param {string} type
   * @param {EventListenerOrEventListenerObject | null} listener
   * @param {boolean | AddEventListenerOptions} [options]
   * @returns {void}
   */
  /** @param {string} type @param {any} listener @param {boolean | AddEventListenerOptions} [options] */
  addEventListener(type, listener, options) {
    super.addEventListener(type, listener, options);
  }

  /**
   * Makes up to `count` steps; how many it made. 0: the fit is done.
   * @param {number} [count]
   */
  step(count = 1) {
    const start = performance.now();
    const made = this.#search.step(count);
    this.#seconds += (performance.now() - start) / 1000;
    this.dispatchEvent(new CustomEvent('progress', { detail: this.progress }));
    return made;
  }

  /**
   * Runs to the end; between two steps others get their turn. Resolves to whether it got there:
   * not if it was cancelled.
   */
  async run() {
    this.#change('idle', 'running');
    while (!this.#search.ended && this.#state !== 'cancelled') {
      if (this.#state === 'paused') {
        await new Promise((wake) => this.addEventListener('state', wake, { once: true }));
        continue;
      }
      this.step();
      await turn();
    }
    const ended = this.#search.ended;
    this.#state = 'idle';
    return ended;
  }

  pause() {
    this.#change('running', 'paused');
  }

  resume() {
    this.#change('paused', 'running');
  }

  cancel() {
    this.#change('running', 'cancelled');
    this.#change('paused', 'cancelled');
  }

  /**
   * @param {'idle' | 'running' | 'paused'} from
   * @param {'running' | 'paused' | 'cancelled'} to
   */
  #change(from, to) {
    if (this.#state !== from) return;
    this.#state = to;
    this.dispatchEvent(new Event('state'));
  }

  /** @returns {Progress} */
  get progress() {
    const { done, ended, converged, fingerprint } = this.#search;
    const total = levels().reduce((sum, { steps }) => sum + steps, 0);
    return { done, total, ended, converged, seconds: this.#seconds, fingerprint };
  }

  /** Hash over the bits of every scene on the way: the same on every machine. */
  get fingerprint() {
    return this.#search.fingerprint;
  }

  /** The energy (negative log posterior density, up to a constant) after every step. @returns {TracePoint[]} */
  get trace() {
    const numbers = [...this.#search.trace()];
    return Array.from({ length: numbers.length / 2 }, (_, i) => ({ level: numbers[2 * i], energy: numbers[2 * i + 1] }));
  }

  /** Left, top, width and height of what the fit looks at, pixels of a photo. */
  crop(photo = 0) {
    return [...this.#search.crop(photo)];
  }

  /**
   * The face so far drawn over what the fit looks at.
   * @param {{ behind?: boolean, photo?: number }} [how] Whether what hides the face is before it.
   */
  overlay({ behind = false, photo = 0 } = {}) {
    return this.#search.overlay(photo, behind);
  }

  /** Where what the fit looks at shows the face (white) and where it does not (black). */
  mask(photo = 0) {
    return this.#search.mask(photo);
  }

  /**
   * What the fit leaves behind; it cannot go on afterwards.
   * @param {{ model?: string, photo?: string | string[] }} [names] File names to mention, one for each photo.
   */
  finish({ model = 'model.3dmm', photo } = {}) {
    const numbered = Array.from({ length: this.photos }, (_, i) => `photo-${i + 1}.png`);
    const names = photo ?? (this.photos > 1 ? numbered : 'photo.png');
    const search = this.#search;
    this.#kept = undefined;
    return search.finish(this.#seconds, model, [names].flat());
  }

  free() {
    this.#kept?.free();
    this.#kept = undefined;
  }
}

/** Lets messages and timers have their turn, sooner than a timer would. */
function turn() {
  const { port1, port2 } = new MessageChannel();
  return new Promise((done) => {
    port1.onmessage = () => {
      port1.close();
      done(undefined);
    };
    port2.postMessage(0);
  });
}
