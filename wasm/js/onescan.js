/**
 * onescan in JavaScript: models, photos and fits in the thread that calls.
 *
 * In a page, a fit belongs into a worker: see `connect()` in client.js, which has the same names.
 */

import init, { Fit as Chain, Model, Photo, Viewer } from './wasm/onescan_wasm.js';

export { Model, Photo, Viewer };

/** @typedef {{ name: string, x: number, y: number, visible?: boolean }} Landmark Pixels of the photo; pixel (x, y) is the point (x, y). */
/** @typedef {{ seed?: number, samples?: number, landmarkSamples?: number, shapeSamples?: number, landmarkSd?: number, shapeRank?: number, albedoRank?: number, size?: number, pixelPatch?: number, sampler?: boolean }} Settings As the options of `onescan fit --schedule paper`, or `sampler`. */
/** @typedef {{ done: number, total: number, stage: 'landmarks' | 'shape' | 'image', seconds: number, stepsPerSecond: number, fingerprint: string }} Progress Speed is that of the image stage, once it has begun. */
/** @typedef {{ name: string, bytes: Uint8Array<ArrayBuffer> }} SavedFile */
/** @typedef {import('./wasm/onescan_wasm.js').Fitted} Fitted */

/** How long a running fit computes before it lets others have a word, milliseconds. */
const SLICE = 25;
/** Steps between two looks at the clock. */
const BATCH = 8;

/**
 * Loads the program.
 * @param {BufferSource | WebAssembly.Module | URL} [source] Where onescan_wasm_bg.wasm is; beside this file by default.
 */
export async function create(source) {
  await init({ module_or_path: source ?? (await beside()) });
  return new Onescan();
}

/** The program's bytes or address: Node's fetch knows no files. */
async function beside() {
  const url = new URL('./wasm/onescan_wasm_bg.wasm', import.meta.url);
  if (url.protocol !== 'file:') return url;
  const { readFile } = await import('node:fs/promises');
  return new Uint8Array(await readFile(url));
}

/** What `create()` gives. */
export class Onescan {
  /**
   * A model of the bytes of a `.3dmm` file.
   * @param {Uint8Array} bytes
   */
  model(bytes) {
    return new Model(bytes);
  }

  /**
   * A photo of the bytes of a PNG or JPEG, or of RGBA pixels.
   * @param {Uint8Array | { width: number, height: number, data: ArrayLike<number> }} source
   */
  photo(source) {
    if (source instanceof Uint8Array) return new Photo(source);
    return Photo.fromRgba(source.width, source.height, Uint8Array.from(source.data));
  }

  /**
   * Prepares a fit.
   * @param {{ model: Model, photo: Photo, landmarks: string | Landmark[] } & Settings} job
   */
  fit({ model, photo, landmarks, ...settings }) {
    return new Fit(new Chain(model, photo, tlms(landmarks), JSON.stringify(settings)));
  }

  /**
   * A view of a model's faces.
   * @param {Model} model
   */
  viewer(model) {
    return new Viewer(model);
  }
}

/**
 * Landmarks as the text of a `.tlms` file.
 * @param {string | Landmark[]} landmarks
 */
function tlms(landmarks) {
  if (typeof landmarks === 'string') return landmarks;
  const line = (/** @type {Landmark} */ { name, x, y, visible = true }) =>
    `${name} ${visible ? 1 : 0} ${x} ${y}\n`;
  return landmarks.map(line).join('');
}

/** A fit. Fires `progress` (with a {@link Progress} as `detail`) after every call of `step()`. */
export class Fit extends EventTarget {
  #chain;
  #seconds = 0;
  #imageSeconds = 0;
  #imageSteps = 0;
  /** @type {'idle' | 'running' | 'paused' | 'cancelled'} */
  #state = 'idle';

  /** @param {Chain} chain */
  constructor(chain) {
    super();
    this.#chain = chain;
  }

  /**
   * Makes up to `count` steps; how many it made. 0: the fit is done.
   * @param {number} [count]
   */
  step(count = 1) {
    const made = this.#advance(count);
    this.#report();
    return made;
  }

  /** @param {number} count */
  #advance(count) {
    const chain = this.#chain;
    const image = chain.stage === 'image';
    const start = performance.now();
    const made = chain.step(count);
    const seconds = (performance.now() - start) / 1000;
    this.#seconds += seconds;
    if (image) {
      this.#imageSeconds += seconds;
      this.#imageSteps += made;
    }
    return made;
  }

  #report() {
    this.dispatchEvent(new CustomEvent('progress', { detail: this.progress }));
  }

  /**
   * Runs to the end, in slices between which others get their turn. Resolves to whether it got
   * there: not if it was cancelled.
   */
  async run() {
    this.#change('idle', 'running');
    let done = false;
    while (!done && this.#state !== 'cancelled') {
      if (this.#state === 'paused') {
        await new Promise((wake) => this.addEventListener('state', wake, { once: true }));
        continue;
      }
      const end = performance.now() + SLICE;
      while (!done && performance.now() < end) done = this.#advance(BATCH) < BATCH;
      this.#report();
      if (!done) await turn();
    }
    this.#state = 'idle';
    return done;
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
    const { done, total, fingerprint } = this.#chain;
    const stepsPerSecond = this.#imageSteps / Math.max(this.#imageSeconds, 1e-9);
    const stage = /** @type {Progress['stage']} */ (this.#chain.stage);
    return { done, total, stage, seconds: this.#seconds, stepsPerSecond, fingerprint };
  }

  /** Hash over the bits of every accepted state: the same from the same seed on every machine. */
  get fingerprint() {
    return this.#chain.fingerprint;
  }

  /** Log likelihood by step: `[step, value, step, value, …]`. */
  get trace() {
    return this.#chain.trace();
  }

  /** Left, top, width and height of what the fit looks at, pixels of the photo. */
  get crop() {
    return [...this.#chain.crop];
  }

  /** The current state drawn over what the fit looks at. */
  overlay() {
    return this.#chain.overlay();
  }

  /**
   * What the fit leaves behind; it cannot go on afterwards.
   * @param {{ model?: string, photo?: string }} [names] File names to mention.
   */
  finish({ model = 'model.3dmm', photo = 'photo.png' } = {}) {
    return this.#chain.finish(this.#seconds, model, photo);
  }

  free() {
    this.#chain.free();
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
