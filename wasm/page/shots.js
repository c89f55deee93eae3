/** The photos of one person, side by side: which is shown is chosen here. */

import { context } from './dom.js';

/** @typedef {import('./editor.js').Shot} Shot */

/** Side of a thumbnail, pixels of the page. */
const SIDE = 64;

export class Shots {
  #place;
  #choose;
  /** @type {WeakMap<Shot, HTMLButtonElement>} */
  #buttons = new WeakMap();

  /**
   * @param {HTMLElement} place
   * @param {(shot: Shot) => void} choose
   */
  constructor(place, choose) {
    this.#place = place;
    this.#choose = choose;
  }

  /**
   * Brings the thumbnails up to date; one photo alone needs none.
   * @param {Shot[]} shots
   * @param {Shot | undefined} chosen
   * @param {{ disabled: boolean, lacking: (shot: Shot) => boolean }} how Whether none may be chosen, and which lack landmarks.
   */
  show(shots, chosen, { disabled, lacking }) {
    const all = shots.length > 1 ? shots : [];
    const buttons = all.map((shot) => this.#button(shot));
    const same = this.#place.children.length === all.length && buttons.every((button) => button.parentNode);
    // Whoever is taken out loses the keyboard's focus.
    if (!same) this.#place.replaceChildren(...buttons);
    all.forEach((shot, i) => {
      buttons[i].disabled = disabled;
      buttons[i].ariaPressed = String(shot === chosen);
      buttons[i].classList.toggle('lacking', lacking(shot));
      buttons[i].title = lacking(shot) ? `${shot.name}: landmarks are missing` : shot.name;
    });
  }

  /** @param {Shot} shot */
  #button(shot) {
    const known = this.#buttons.get(shot);
    if (known) return known;
    const button = document.createElement('button');
    const canvas = document.createElement('canvas');
    const name = document.createElement('span');
    button.type = 'button';
    canvas.width = canvas.height = 2 * SIDE;
    const { width, height } = shot.picture;
    const side = Math.min(width, height);
    const square = /** @type {const} */ ([(width - side) / 2, (height - side) / 2, side, side]);
    context(canvas).drawImage(shot.picture, ...square, 0, 0, canvas.width, canvas.height);
    name.textContent = shot.name;
    button.append(canvas, name);
    button.addEventListener('click', () => this.#choose(shot));
    this.#buttons.set(shot, button);
    return button;
  }
}
