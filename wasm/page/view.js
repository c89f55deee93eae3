/** The 3D face: turned by dragging or by arrow keys, drawn by the worker. */

import { context } from './dom.js';

/** Radians a drag across the view turns. */
const DRAG = 2.5;
/** Radians an arrow key turns. */
const KEY = Math.PI / 24;
/** Milliseconds without a change after which the face is drawn finely. */
const REST = 120;
/** As far as the face is looked at from above and below. */
const PITCH = 1.2;

export class View {
  #canvas;
  #client;
  #yaw = 0;
  #pitch = 0;
  /** Whether the worker is drawing, and whether what it draws is outdated already. */
  #drawing = false;
  #stale = false;

  /** @param {HTMLCanvasElement} canvas @param {ReturnType<typeof import('../js/client.js').connect>} client */
  constructor(canvas, client) {
    this.#canvas = canvas;
    this.#client = client;
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      event.preventDefault();
      canvas.focus({ preventScroll: true });
    });
    canvas.addEventListener('pointermove', (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      const scale = DRAG / canvas.clientWidth;
      this.#turn(event.movementX * scale, event.movementY * scale);
    });
    const keys = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    canvas.addEventListener('keydown', (event) => {
      const step = keys[/** @type {keyof keys} */ (event.key)];
      if (!step) return;
      event.preventDefault();
      this.#turn(KEY * step[0], KEY * step[1]);
    });
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.draw());
  }

  /** How it is seen. */
  get camera() {
    const { width, height } = this.#canvas;
    const ground = matchMedia('(prefers-color-scheme: dark)').matches ? 0x2a2f36 : 0xeef0f2;
    return { width, height, yaw: this.#yaw, pitch: this.#pitch, ground };
  }

  /** @param {number} yaw @param {number} pitch */
  #turn(yaw, pitch) {
    this.#yaw += yaw;
    this.#pitch = Math.min(Math.max(this.#pitch + pitch, -PITCH), PITCH);
    this.draw();
  }

  /** Draws it as it is now; if the worker is at it, once more afterwards; and finely once it rests. */
  async draw() {
    this.#stale = true;
    if (this.#drawing) return;
    this.#drawing = true;
    this.#canvas.ariaBusy = 'true';
    try {
      while (this.#stale) {
        await this.#show(false);
        if (!this.#stale) await new Promise((rested) => setTimeout(rested, REST));
        if (!this.#stale) await this.#show(true);
      }
    } finally {
      this.#drawing = false;
      this.#canvas.ariaBusy = 'false';
    }
  }

  /** @param {boolean} fine */
  async #show(fine) {
    this.#stale = false;
    const picture = await this.#client.draw({ ...this.camera, fine });
    context(this.#canvas).drawImage(picture, 0, 0);
    picture.close();
  }
}
