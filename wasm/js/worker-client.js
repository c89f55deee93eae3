/** `onescan/worker`: client.js over a worker that bundlers find. */

import { connect as talk } from './client.js';

/**
 * Starts a worker, or takes one that runs worker.js (which is `onescan/worker.js`).
 * @param {Worker} [worker]
 */
export function connect(worker = new Worker(new URL('./worker.js', import.meta.url), { type: 'module' })) {
  return talk(worker);
}
