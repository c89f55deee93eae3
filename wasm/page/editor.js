/** The photo with its landmarks: zoom, handles to drag or to move by keys, and the fit on top. */

import { context, element } from './dom.js';
import { spoken } from './landmarks.js';

/** @typedef {{ name: string, x: number, y: number }} Point */
/** @typedef {{ pictures: import('../js/worker.js').LivePictures, crop: number[] }} Overlay The face over a part of a photo. */
/** @typedef {import('../js/worker.js').PhotoFacts & { name: string, points: Point[], skipped: Set<string>, faces?: import('../js/faces.js').Face[], face?: number, overlay?: Overlay }} Shot A photo with its landmarks, those that the user says cannot be seen, the faces found and which is taken, and what has been fitted to it. */

const SVG = 'http://www.w3.org/2000/svg';
/** How much of the stage the face takes when shown large. */
const FACE = 0.45;

/** Fires `change` when a landmark was moved and `place` (with `{ x, y }`) on a click beside them. */
export class Editor extends EventTarget {
  #canvas = element('photo', HTMLCanvasElement);
  #handles = element('handles', SVGSVGElement);
  /** @type {Shot | undefined} */
  #photo;
  /** Where the photo's pixel (0, 0) is on the stage, and stage pixels per photo pixel. */
  #view = { x: 0, y: 0, scale: 1 };
  #opacity = 1;
  #behind = true;
  #locked = false;
  #frame = 0;
  /** What to show again when the stage changes its size. @type {'whole' | 'face' | 'other'} */
  #shown = 'whole';

  constructor() {
    super();
    new ResizeObserver(() => this.#resized()).observe(this.#canvas);
    this.#handles.addEventListener('pointerdown', (event) => this.#press(event));
    this.#handles.addEventListener('keydown', (event) => this.#key(event));
  }

  /** Shows a photo with its landmarks. @param {Shot} photo */
  open(photo) {
    this.#photo = photo;
    this.set(photo.points);
    this.whole();
    this.face();
  }

  /** The landmarks of the photo that is shown. */
  get points() {
    return this.#photo?.points ?? [];
  }

  /** A landmark, moved into the photo if it is not. @param {Point} point */
  inside({ name, x, y }) {
    return { name, ...this.#inside(x, y) };
  }

  /** @param {Point[]} points */
  set(points) {
    if (this.#photo) this.#photo.points = points;
    this.#handles.replaceChildren(...points.map((point) => this.#handle(point)));
    this.#place();
  }

  /** While a fit runs, landmarks stay where they are. @param {boolean} locked */
  lock(locked) {
    this.#locked = locked;
  }

  /** Whether landmarks are in sight. @param {boolean} shown */
  show(shown) {
    this.#handles.classList.toggle('away', !shown);
  }

  /** Whether clicks set landmarks. @param {boolean} placing */
  placing(placing) {
    this.#handles.classList.toggle('placing', placing);
  }

  /** Lays the face over a part of a photo, or takes it away. @param {Shot} shot @param {Overlay} [overlay] */
  overlay(shot, overlay) {
    for (const old of Object.values(shot.overlay?.pictures ?? {})) old.close();
    shot.overlay = overlay;
    this.#draw();
  }

  /** @param {boolean} behind Whether what hides the face is before it. */
  behind(behind) {
    this.#behind = behind;
    this.#draw();
  }

  /** @param {number} opacity Of what is laid over. */
  fade(opacity) {
    this.#opacity = opacity;
    this.#draw();
  }

  /** Shows the whole photo. */
  whole() {
    if (!this.#photo) return;
    const { width, height } = this.#size();
    const scale = Math.min(width / this.#photo.width, height / this.#photo.height);
    const middle = [this.#photo.width / 2, this.#photo.height / 2];
    this.#look(middle, scale);
    this.#shown = 'whole';
  }

  /** Shows the landmarks large. */
  face() {
    if (this.points.length < 2) return;
    const xs = this.points.map(({ x }) => x);
    const ys = this.points.map(({ y }) => y);
    const box = [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
    const extent = Math.max(box[2] - box[0], box[3] - box[1], 1);
    const { width, height } = this.#size();
    const middle = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
    this.#look(middle, (FACE * Math.min(width, height)) / extent);
    this.#shown = 'face';
  }

  #resized() {
    if (this.#shown === 'whole') this.whole();
    else if (this.#shown === 'face') this.face();
    else this.zoom(1);
  }

  /** @param {number} factor About the middle of the stage. */
  zoom(factor) {
    const { width, height } = this.#size();
    this.#look(this.#toPhoto(width / 2, height / 2), this.#view.scale * factor);
  }

  #size() {
    return { width: this.#canvas.clientWidth, height: this.#canvas.clientHeight };
  }

  /** @param {number[]} middle Photo point in the middle of the stage. @param {number} scale */
  #look([x, y], scale) {
    const { width, height } = this.#size();
    const bounded = Math.min(Math.max(scale, 0.02), 40);
    this.#view = { x: width / 2 - x * bounded, y: height / 2 - y * bounded, scale: bounded };
    this.#shown = 'other';
    this.#place();
    this.#draw();
  }

  /** @param {number} x @param {number} y */
  #toPhoto(x, y) {
    return [(x - this.#view.x) / this.#view.scale, (y - this.#view.y) / this.#view.scale];
  }

  /** @param {Point} point */
  #handle(point) {
    const group = document.createElementNS(SVG, 'g');
    group.setAttribute('tabindex', '0');
    group.setAttribute('role', 'button');
    group.setAttribute('aria-label', `${spoken(point.name)}: arrow keys move it, Delete removes it`);
    // The larger, invisible circle is for fingers.
    for (const [kind, radius] of [['grip', 16], ['dot', 5]]) {
      const circle = document.createElementNS(SVG, 'circle');
      circle.setAttribute('class', String(kind));
      circle.setAttribute('r', String(radius));
      group.append(circle);
    }
    const text = document.createElementNS(SVG, 'text');
    text.setAttribute('x', '10');
    text.setAttribute('y', '-8');
    text.textContent = spoken(point.name);
    group.append(text);
    return group;
  }

  /** Puts the handles where the points are. */
  #place() {
    const { x, y, scale } = this.#view;
    this.points.forEach((point, index) => {
      // A point of the photo is the centre of its pixel.
      const at = `translate(${x + (point.x + 0.5) * scale} ${y + (point.y + 0.5) * scale})`;
      this.#handles.children[index]?.setAttribute('transform', at);
    });
  }

  /** Draws in the next frame. */
  #draw() {
    if (this.#frame) return;
    this.#frame = requestAnimationFrame(() => {
      this.#frame = 0;
      this.#paint();
    });
  }

  #paint() {
    const { width, height } = this.#size();
    const ratio = window.devicePixelRatio || 1;
    const canvas = this.#canvas;
    const sides = [width, height].map((side) => Math.round(side * ratio));
    if (canvas.width !== sides[0]) canvas.width = sides[0];
    if (canvas.height !== sides[1]) canvas.height = sides[1];
    const draw = context(canvas);
    const { x, y, scale } = this.#view;
    draw.setTransform(1, 0, 0, 1, 0, 0);
    draw.clearRect(0, 0, canvas.width, canvas.height);
    if (!this.#photo) return;
    draw.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * x, ratio * y);
    draw.drawImage(this.#photo.picture, 0, 0, this.#photo.width, this.#photo.height);
    if (this.#photo.overlay) {
      const [left, top, wide, high] = this.#photo.overlay.crop;
      draw.globalAlpha = this.#opacity;
      const { overlay, behind } = this.#photo.overlay.pictures;
      draw.drawImage(this.#behind ? behind : overlay, left, top, wide, high);
      draw.globalAlpha = 1;
    }
  }

  /** A landmark or, beside them, the photo is grabbed. @param {PointerEvent} event */
  #press(event) {
    if (!this.#photo || this.#locked || event.button !== 0) return;
    const group = event.target instanceof Element ? event.target.closest('g') : null;
    const box = this.#handles.getBoundingClientRect();
    const at = (/** @type {PointerEvent} */ e) => [e.clientX - box.left, e.clientY - box.top];
    const start = at(event);
    const index = group ? [...this.#handles.children].indexOf(group) : -1;
    const { x, y } = index < 0 ? this.#view : this.points[index];
    let moved = false;
    event.preventDefault();
    this.#handles.setPointerCapture(event.pointerId);
    group?.focus();
    const move = (/** @type {PointerEvent} */ e) => {
      const [dx, dy] = at(e).map((value, axis) => value - start[axis]);
      // A finger is never quite still.
      moved ||= Math.hypot(dx, dy) > 3;
      if (!moved) return;
      if (index < 0) {
        this.#view = { ...this.#view, x: x + dx, y: y + dy };
        this.#shown = 'other';
        this.#place();
        this.#draw();
      } else {
        this.#move(index, x + dx / this.#view.scale, y + dy / this.#view.scale);
      }
    };
    const end = (/** @type {PointerEvent} */ e) => {
      this.#handles.removeEventListener('pointermove', move);
      this.#handles.removeEventListener('pointerup', end);
      this.#handles.removeEventListener('pointercancel', end);
      if (e.type === 'pointercancel') return;
      if (moved) {
        if (index >= 0) this.dispatchEvent(new Event('change'));
      } else if (index < 0) {
        const [px, py] = this.#toPhoto(start[0], start[1]);
        this.dispatchEvent(new CustomEvent('place', { detail: this.#inside(px - 0.5, py - 0.5) }));
      }
    };
    this.#handles.addEventListener('pointermove', move);
    this.#handles.addEventListener('pointerup', end);
    this.#handles.addEventListener('pointercancel', end);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const index = [...this.#handles.children].indexOf(/** @type {Element} */ (event.target));
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[/** @type {keyof steps} */ (event.key)];
    if (index < 0 || this.#locked) return;
    if (step) {
      // A step is a pixel of the stage; ten with Shift.
      const far = (event.shiftKey ? 10 : 1) / this.#view.scale;
      const { x, y } = this.points[index];
      this.#move(index, x + far * step[0], y + far * step[1]);
    } else if (event.key === 'Delete' || event.key === 'Backspace') {
      this.set(this.points.filter((_, other) => other !== index));
    } else {
      return;
    }
    event.preventDefault();
    this.dispatchEvent(new Event('change'));
  }

  /** @param {number} index @param {number} x @param {number} y */
  #move(index, x, y) {
    Object.assign(this.points[index], this.#inside(x, y));
    this.#place();
  }

  /** The nearest point of the photo, to a hundredth of a pixel. @param {number} x @param {number} y */
  #inside(x, y) {
    const { width, height } = this.#photo ?? { width: 1, height: 1 };
    const within = (/** @type {number} */ value, /** @type {number} */ side) =>
      Math.round(100 * Math.min(Math.max(value, 0), side - 1)) / 100;
    return { x: within(x, width), y: within(y, height) };
  }
}
