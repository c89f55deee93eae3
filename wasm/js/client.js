/**
 * onescan in a worker: the page stays free while a fit runs.
 *
 * A `Client` has the worker's methods, each of which gives a promise.
 */

import { scriptUrl } from './trusted.js';

/** @typedef {import('./worker.js').Methods} Methods */
/** @typedef {{ [K in keyof Methods]: (...args: Parameters<Methods[K]>) => Promise<Awaited<ReturnType<Methods[K]>>> }} Remote */
/** @typedef {CustomEvent<import('./worker.js').LiveProgress>} ProgressEvent How a fit goes. */
/** @typedef {{ addEventListener(type: 'progress', listener: (event: ProgressEvent) => void, options?: AddEventListenerOptions): void, close(): void }} Own `close` ends the worker. */
/** @typedef {Own & Remote & EventTarget} Client */

const METHODS = /** @type {const} */ ([
  'open', 'photo', 'addPhoto', 'removePhoto', 'faces', 'watch', 'fit', 'pause', 'resume', 'cancel', 'fitFiles', 'draw', 'drawMean', 'png', 'locate', 'set',
  'random', 'mean', 'fitted', 'dress', 'light', 'files',
]);

/**
 * Talks to a worker that runs worker.js. Once that has stopped, every call is rejected.
 * @param {Worker} [worker] By default a new one, which may load what the page may.
 * @returns {Client}
 */
export function connect(worker = heir()) {
  const target = new EventTarget();
  /** @type {Map<number, { resolve: (value: any) => void, reject: (error: Error) => void }>} */
  const calls = new Map();
  let last = 0;
  worker.addEventListener('message', ({ data }) => {
    if (data.progress) {
      target.dispatchEvent(new CustomEvent('progress', { detail: data.progress }));
      return;
    }
    const call = calls.get(data.id);
    calls.delete(data.id);
    if ('error' in data) call?.reject(new Error(data.error));
    else call?.resolve(data.value);
  });
  /** @type {Error | undefined} */
  let stopped;
  /** @param {string} why */
  const stop = (why) => {
    stopped ??= new Error(`the worker stopped: ${why}`);
    worker.terminate();
    for (const call of calls.values()) call.reject(stopped);
    calls.clear();
  };
  worker.addEventListener('error', (event) => {
    event.preventDefault();
    stop(event.message || 'it could not be loaded');
  });
  worker.addEventListener('messageerror', () => stop('its answer could not be read'));
  const remote = METHODS.map((method) => [
    method,
    (/** @type {unknown[]} */ ...args) =>
      new Promise((resolve, reject) => {
        if (stopped) throw stopped;
        const id = (last += 1);
        worker.postMessage({ id, method, args });
        calls.set(id, { resolve, reject });
      }),
  ]);
  const own = Object.assign(Object.fromEntries(remote), { close: () => stop('it was closed') });
  return Object.assign(target, /** @type {Own & Remote} */ (own));
}

/**
 * A worker born of some lines of script instead of its file, because such a one inherits the page's
 * Content-Security-Policy: what the page may not load, the worker may not either. They keep what is
 * said before its file is there. (With a plain import, Firefox would not ask the service worker for it.)
 * Bundlers do not find worker.js here, nor should they: see worker-client.js.
 */
function heir() {
  const here = import.meta.url;
  const lines = `
    const early = [];
    self.onmessage = ({ data }) => early.push(data);
    import(${JSON.stringify(new URL('./worker.js', here).href)}).then(
      () => {
        self.onmessage = null;
        for (const data of early) self.dispatchEvent(new MessageEvent('message', { data }));
      },
      (error) => setTimeout(() => { throw error; }),
    );`;
  const birth = URL.createObjectURL(new Blob([lines], { type: 'text/javascript' }));
  const worker = new Worker(scriptUrl(birth), { type: 'module' });
  for (const event of ['message', 'error']) {
    worker.addEventListener(event, () => URL.revokeObjectURL(birth), { once: true });
  }
  return worker;
}
