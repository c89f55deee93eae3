/**
 * Keeps the page, so that it works without a network. What is on the network comes first: so nobody is
 * given old files, or files of two builds. The build writes VERSION, a hash of all files, and FILES before
 * this.
 */
/* global VERSION, FILES */

const MINE = 'onescan ';
const KEPT = MINE + VERSION;

/** @param {Request | string} request Asks the server whether what the browser has is still true. */
const current = (request) => new Request(request, { cache: 'no-cache' });

async function install() {
  const cache = await caches.open(KEPT);
  await cache.addAll(FILES.map(current));
  await self.skipWaiting();
}

async function activate() {
  const old = (await caches.keys()).filter((name) => name.startsWith(MINE) && name !== KEPT);
  await Promise.all(old.map((name) => caches.delete(name)));
  await self.clients.claim();
}

/** @param {Request} request */
async function answer(request) {
  const cache = await caches.open(KEPT);
  try {
    const response = await fetch(current(request));
    // Samples are kept once they were asked for.
    if (response.ok && new URL(request.url).pathname.includes('/samples/')) await cache.put(request, response.clone());
    return response;
  } catch (error) {
    const kept = await cache.match(request, { ignoreSearch: true });
    if (kept) return kept;
    throw error;
  }
}

self.addEventListener('install', (event) => event.waitUntil(install()));
self.addEventListener('activate', (event) => event.waitUntil(activate()));
self.addEventListener('fetch', (event) => {
  const { request } = event;
  if (request.method === 'GET' && new URL(request.url).origin === location.origin) event.respondWith(answer(request));
});
