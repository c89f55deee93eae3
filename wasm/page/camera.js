/** A photo by the camera. */

import { button, context, element } from './dom.js';

/** What is wrong if there is no picture, by the name of the browser's error. */
const REFUSED = {
  NotAllowedError: 'the camera was refused; allow it for this page beside its address, or choose a photo',
  NotFoundError: 'this device has no camera; choose a photo',
  NotReadableError: 'another program uses the camera; close it, or choose a photo',
};

/**
 * Shows what the camera sees; the picture taken, or nothing if the dialog was closed.
 * @returns {Promise<ImageData | undefined>}
 */
export async function openCamera() {
  if (!navigator.mediaDevices) throw new Error('this browser gives no camera to pages without https');
  const stream = await navigator.mediaDevices
    .getUserMedia({ video: { facingMode: 'user', width: { ideal: 1280 } } })
    .catch((error) => {
      throw new Error(REFUSED[/** @type {keyof REFUSED} */ (error.name)] ?? `no camera: ${error.message}; choose a photo`);
    });
  const video = element('video', HTMLVideoElement);
  const dialog = element('camera-dialog', HTMLDialogElement);
  const stop = new AbortController();
  const { signal } = stop;
  try {
    video.srcObject = stream;
    await video.play();
    dialog.showModal();
    return await new Promise((resolve) => {
      dialog.addEventListener('close', () => resolve(undefined), { signal });
      button('camera-close').addEventListener('click', () => dialog.close(), { signal });
      button('shoot').addEventListener('click', () => resolve(still(video)), { signal });
    });
  } finally {
    stop.abort();
    dialog.close();
    for (const track of stream.getTracks()) track.stop();
  }
}

/** @param {HTMLVideoElement} video */
function still(video) {
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
  const draw = context(canvas);
  draw.drawImage(video, 0, 0);
  return draw.getImageData(0, 0, canvas.width, canvas.height);
}
