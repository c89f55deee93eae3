/** The photo with its landmarks: zoom, handles to drag or to move by keys, and the fit on top. */

import { context, element } from './dom.js';
import { spoken } from './landmarks.js';

/** @typedef {{ name: string, x: number, y: number }} Point */
/** @typedef {{ pictures: import('../js/worker.js').LivePictures, crop: number[] }} Overlay The face over a part of a photo. */
/** @typedef {{ points: Point[], skipped: Set<string> }} Marks Landmarks, and those that the user says cannot be seen. */
/** @typedef {import('../js/worker.js').PhotoFacts & Marks & { name: string, past: Marks[], given?: Marks, faces?: import('../js/faces.js').Face[], face?: number, overlay?: Overlay }} Shot A photo with its landmarks, those of before every change and those that were found or given, the faces found and which is taken, and what has been fitted to it. */

/** @param {Marks} marks @returns {Marks} */
export const copied = ({ points, skipped }) => ({ points: points.map((point) => ({ ...point })), skipped: new Set(skipped) });

const SVG = 'http://www.w3.org/2000/svg';
/** How much of the stage the face takes when shown large. */
const FACE = 0.45;

/** Changes that can be undone. */
const MOST = 200;

/** Fires `change` when a landmark was moved and `place` (with `{ x, y }`) on a click beside them or by Enter. */
export class Editor extends EventTarget {
  #canvas = element('photo', HTMLCanvasElement);
  #handles = element('handles', SVGSVGElement);
  /** @type {Shot | undefined} */
  #photo;
  /** Where the photo's pixel (0, 0) is on the stage, and stage pixels per photo pixel. */
  #view = { x: 0, y: 0, scale: 1 };
  #opacity = 1;
  #behind = true;
  #counts = false;
  /** How far the photo comes before the fit, of the stage's width. */
  #wipe = 0;
  #locked = false;
  #frame = 0;
  /** What to show again when the stage changes its size. @type {'whole' | 'face' | 'other'} */
  #shown = 'whole';
  /** Where fingers or the mouse are. @type {Map<number, number[]>} */
  #pointers = new Map();
  /** What is dragged: a landmark, or with −1 the photo. */
  #drag = { index: -1, start: [0, 0], x: 0, y: 0, moved: false };
  /** The landmark that keys move: all their steps are one change. */
  #stepped = -1;

  constructor() {
    super();
    new ResizeObserver(() => this.#resized()).observe(this.#canvas);
    this.#handles.addEventListener('pointerdown', (event) => this.#press(event));
    this.#handles.addEventListener('pointermove', (event) => this.#follow(event));
    for (const end of ['pointerup', 'pointercancel']) {
      this.#handles.addEventListener(end, (event) => this.#release(/** @type {PointerEvent} */ (event)));
    }
    this.#handles.addEventListener('wheel', (event) => this.#wheel(event), { passive: false });
    this.#handles.addEventListener('focusin', () => (this.#stepped = -1));
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
    const focused = this.#index(document.activeElement);
    if (this.#photo) this.#photo.points = points;
    this.#handles.replaceChildren(...points.map((point) => this.#handle(point)));
    this.#place();
    // Whoever is replaced loses the keyboard's focus.
    if (focused >= 0) this.focus(Math.min(focused, points.length - 1));
  }

  /** Gives a landmark the keyboard's focus. @param {number} index */
  focus(index) {
    const handle = this.#handles.children[index];
    if (handle instanceof SVGElement) handle.focus({ preventScroll: true });
  }

  /** Lays the landmarks by, before they are changed. */
  remember() {
    const { past } = this.#photo ?? {};
    if (!this.#photo || !past) return;
    past.push(copied(this.#photo));
    past.splice(0, past.length - MOST);
  }

  /** Takes the last change back. */
  undo() {
    const before = this.#photo?.past.pop();
    if (before) this.#restore(before);
  }

  /** Takes all changes of what was found or given back. */
  reset() {
    if (!this.#photo?.given) return;
    this.remember();
    this.#restore(copied(this.#photo.given));
  }

  /** @param {Marks} marks */
  #restore({ points, skipped }) {
    if (this.#photo) this.#photo.skipped = skipped;
    this.#stepped = -1;
    this.set(points);
    this.dispatchEvent(new Event('change'));
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

  /** @param {boolean} counts Whether what the fit holds to be no face is dark. */
  counts(counts) {
    this.#counts = counts;
    this.#draw();
  }

  /** @param {number} share Of the stage, from the left, that shows the photo alone. */
  wipe(share) {
    this.#wipe = share;
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

  /** @param {number} factor @param {number[]} [at] The point of the stage that stays; its middle by default. */
  zoom(factor, at = this.#middle()) {
    this.#look(this.#toPhoto(at[0], at[1]), this.#view.scale * factor, at);
  }

  /** The point of the photo in the middle of the stage. */
  get middle() {
    const [x, y] = this.#middle();
    const [px, py] = this.#toPhoto(x, y);
    return this.#inside(px - 0.5, py - 0.5);
  }

  #middle() {
    const { width, height } = this.#size();
    return [width / 2, height / 2];
  }

  #size() {
    return { width: this.#canvas.clientWidth, height: this.#canvas.clientHeight };
  }

  /** @param {number[]} point Of the photo. @param {number} scale @param {number[]} [at] Where on the stage it is to be; in its middle by default. */
  #look([x, y], scale, at = this.#middle()) {
    const bounded = Math.min(Math.max(scale, 0.02), 40);
    this.#view = { x: at[0] - x * bounded, y: at[1] - y * bounded, scale: bounded };
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
    group.setAttribute('aria-label', `${spoken(point.name)}: arrow keys move it, Enter sets the next, Delete removes it`);
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
    if (this.#photo.overlay) this.#lay(draw, this.#photo.overlay, -x / scale + (this.#wipe * width) / scale);
  }

  /** @param {CanvasRenderingContext2D} draw @param {Overlay} overlay @param {number} border Left of it the photo is alone. */
  #lay(draw, { crop: [left, top, wide, high], pictures }, border) {
    const cut = Math.max(border - left, 0);
    draw.save();
    draw.beginPath();
    draw.rect(left + cut, top, wide - cut, high);
    draw.clip();
    draw.globalAlpha = this.#opacity;
    if (this.#counts) draw.globalCompositeOperation = 'multiply';
    const shown = this.#counts ? pictures.mask : this.#behind ? pictures.behind : pictures.overlay;
    if (cut < wide) draw.drawImage(shown, left, top, wide, high);
    draw.restore();
    if (this.#wipe === 0) return;
    draw.fillStyle = '#ffffff';
    draw.fillRect(border, top, 2 / this.#view.scale, high);
  }

  /** The number of a landmark's handle; −1 if it is none. @param {EventTarget | null} target */
  #index(target) {
    const group = target instanceof Element ? target.closest('g') : null;
    return group ? [...this.#handles.children].indexOf(group) : -1;
  }

  /** @param {MouseEvent} event */
  #at(event) {
    const box = this.#handles.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** A landmark or, beside them, the photo is grabbed. @param {PointerEvent} event */
  #press(event) {
    if (!this.#photo || event.button !== 0) return;
    const start = this.#at(event);
    const index = this.#locked ? -1 : this.#index(event.target);
    const { x, y } = index < 0 ? this.#view : this.points[index];
    event.preventDefault();
    this.#handles.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, start);
    this.focus(index);
    // A second finger moves and zooms the photo, and is no click.
    const second = this.#pointers.size > 1;
    this.#drag = { index: second ? -1 : index, start, x, y, moved: second };
  }

  /** @param {PointerEvent} event */
  #follow(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const at = this.#at(event);
    const { index, start, x, y } = this.#drag;
    this.#pointers.set(event.pointerId, at);
    const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    if (other) {
      const apart = (/** @type {number[]} */ place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
      const middle = (/** @type {number[]} */ place) => place.map((value, axis) => (value + other[axis]) / 2);
      const [from, to] = [middle(before), middle(at)];
      this.#look(this.#toPhoto(from[0], from[1]), (this.#view.scale * apart(at)) / apart(before), to);
      return;
    }
    const [dx, dy] = at.map((value, axis) => value - start[axis]);
    if (!this.#drag.moved) {
      // A finger is never quite still.
      if (Math.hypot(dx, dy) <= 3) return;
      this.#drag.moved = true;
      if (index >= 0) this.remember();
    }
    if (index >= 0) {
      this.#move(index, x + dx / this.#view.scale, y + dy / this.#view.scale);
    } else {
      this.#view = { ...this.#view, x: x + dx, y: y + dy };
      this.#shown = 'other';
      this.#place();
      this.#draw();
    }
  }

  /** @param {PointerEvent} event */
  #release(event) {
    if (!this.#pointers.delete(event.pointerId)) return;
    const { index, start, moved } = this.#drag;
    // A finger that stays does not drag on.
    const [rest] = this.#pointers.values();
    if (rest) this.#drag = { ...this.#drag, index: -1, start: rest, x: this.#view.x, y: this.#view.y };
    else if (event.type === 'pointercancel') return;
    else if (moved && index >= 0) this.dispatchEvent(new Event('change'));
    else if (!moved && index < 0) {
      const [px, py] = this.#toPhoto(start[0], start[1]);
      this.dispatchEvent(new CustomEvent('place', { detail: this.#inside(px - 0.5, py - 0.5) }));
    }
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    if (!this.#photo) return;
    event.preventDefault();
    // Lines or pixels; a pinch on a touchpad comes as small steps with Ctrl.
    const step = event.deltaY * (event.deltaMode ? 0.05 : event.ctrlKey ? 0.01 : 0.0015);
    this.zoom(Math.exp(-step), this.#at(event));
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const index = this.#index(event.target);
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[/** @type {keyof steps} */ (event.key)];
    if (index < 0 || this.#locked) return;
    if (step) {
      if (this.#stepped !== index) this.remember();
      this.#stepped = index;
      // A step is a pixel of the stage; ten with Shift.
      const far = (event.shiftKey ? 10 : 1) / this.#view.scale;
      const { x, y } = this.points[index];
      this.#move(index, x + far * step[0], y + far * step[1]);
    } else if (event.key === 'Delete' || event.key === 'Backspace') {
      this.remember();
      this.set(this.points.filter((_, other) => other !== index));
    } else if (event.key === 'Enter') {
      const { x, y } = this.points[index];
      this.dispatchEvent(new CustomEvent('place', { detail: { x, y, focus: true } }));
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
