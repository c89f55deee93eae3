/**
 * onescan in a worker: the page stays free while a fit runs.
 *
 * A `Client` has the worker's methods, each of which gives a promise.
 */

import { scriptUrl } from './trusted.js';

/** @typedef {import('./worker.js').Methods} Methods */
/** @typedef {{ [K in keyof Methods]: (...args: Parameters<Methods[K]>) => Promise<Awaited<ReturnType<Methods[K]>>> }} Remote */

const METHODS = /** @type {const} */ ([
  'open', 'photo', 'addPhoto', 'removePhoto', 'faces', 'watch', 'fit', 'pause', 'resume', 'cancel', 'fitFiles', 'draw', 'drawMean', 'png', 'locate', 'set',
  'random', 'mean', 'fitted', 'dress', 'light', 'files',
]);

/**
 * Starts a worker. Of its events, `progress` tells how a fit goes (see `LiveProgress` in
 * worker.js).
 *
 * The worker is born of some lines of script instead of its file, because such a one inherits the
 * page's Content-Security-Policy: what the page may not load, the worker may not either. They keep what is
 * said before its file is there. (With a plain import, Firefox would not ask the service worker for it.)
 * @param {URL} [url] Of worker.js.
 * @returns {EventTarget & Remote}
 */
export function connect(url = new URL('./worker.js', import.meta.url)) {
  const lines = `
    const early = [];
    self.onmessage = ({ data }) => early.push(data);
    import(${JSON.stringify(url.href)}).then(
      () => {
        self.onmessage = null;
        for (const data of early) self.dispatchEvent(new MessageEvent('message', { data }));
      },
      (error) => setTimeout(() => { throw error; }),
    );`;
  const birth = URL.createObjectURL(new Blob([lines], { type: 'text/javascript' }));
  const worker = new Worker(scriptUrl(birth), { type: 'module' });
  const target = new EventTarget();
  /** @type {Map<number, { resolve: (value: any) => void, reject: (error: Error) => void }>} */
  const calls = new Map();
  let last = 0;
  worker.addEventListener('message', ({ data }) => {
    URL.revokeObjectURL(birth);
    if (data.progress) {
      target.dispatchEvent(new CustomEvent('progress', { detail: data.progress }));
      return;
    }
    const call = calls.get(data.id);
    calls.delete(data.id);
    if ('error' in data) call?.reject(new Error(data.error));
    else call?.resolve(data.value);
  });
  worker.addEventListener('error', (event) => {
    event.preventDefault();
    const error = new Error(`the worker stopped: ${event.message || 'it could not be loaded'}`);
    for (const call of calls.values()) call.reject(error);
    calls.clear();
  });
  const remote = METHODS.map((method) => [
    method,
    (/** @type {unknown[]} */ ...args) =>
      new Promise((resolve, reject) => {
        const id = (last += 1);
        calls.set(id, { resolve, reject });
        worker.postMessage({ id, method, args });
      }),
  ]);
  return Object.assign(target, /** @type {Remote} */ (Object.fromEntries(remote)));
}
