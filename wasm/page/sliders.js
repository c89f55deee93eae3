/** Sliders for the components of shape and albedo. */

/** @typedef {import('../js/worker.js').Coefficients} Coefficients */

/** Components in sight, of each half. */
const SHOWN = 10;
/** Components in a fold, of which the rest are. */
const FOLDED = 20;
/** Standard deviations a slider reaches. */
const REACH = 3;

export class Sliders {
  #place;
  #changed;

  /**
   * @param {HTMLElement} place
   * @param {(values: Coefficients) => void} changed
   */
  constructor(place, changed) {
    this.#place = place;
    this.#changed = changed;
  }

  /** @param {Coefficients} values */
  show({ shape, albedo }) {
    const own = { shape: shape.slice(), albedo: albedo.slice() };
    const tell = () => this.#changed(own);
    const open = [...this.#place.querySelectorAll('details')].map((fold) => fold.open);
    this.#place.replaceChildren(
      group('Shape, standard deviations', own.shape, tell),
      group('Colour, standard deviations', own.albedo, tell),
    );
    // Folds stay as they were.
    this.#place.querySelectorAll('details').forEach((fold, i) => (fold.open = open[i]));
  }
}

/**
 * @param {string} title
 * @param {Float32Array} values
 * @param {() => void} changed
 */
function group(title, values, changed) {
  const set = document.createElement('fieldset');
  const legend = document.createElement('legend');
  legend.textContent = title;
  set.append(legend, ...range(values, 0, SHOWN, changed));
  for (let from = SHOWN; from < values.length; from += FOLDED) {
    const fold = document.createElement('details');
    const summary = document.createElement('summary');
    summary.textContent = `${from + 1} to ${Math.min(from + FOLDED, values.length)}`;
    fold.append(summary);
    // Nobody opens them all.
    fold.addEventListener('toggle', () => fold.append(...range(values, from, FOLDED, changed)), { once: true });
    set.append(fold);
  }
  return set;
}

/**
 * Sliders of some components.
 * @param {Float32Array} values
 * @param {number} from
 * @param {number} count
 * @param {() => void} changed
 */
function range(values, from, count, changed) {
  return [...values.keys()].slice(from, from + count).map((i) => {
    const label = document.createElement('label');
    const slider = document.createElement('input');
    const output = document.createElement('output');
    Object.assign(slider, { type: 'range', min: -REACH, max: REACH, step: 0.05, value: values[i] });
    const show = () => (output.textContent = values[i].toFixed(2));
    slider.addEventListener('input', () => {
      values[i] = slider.valueAsNumber;
      show();
      changed();
    });
    show();
    label.append(String(i + 1), slider, output);
    return label;
  });
}
