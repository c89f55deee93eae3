/** Sliders for the first components of shape and albedo. */

/** @typedef {import('../js/worker.js').Coefficients} Coefficients */

/** Components with a slider, of each half. */
const SHOWN = 8;
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
    this.#place.replaceChildren(
      group('Shape, standard deviations', own.shape, tell),
      group('Colour, standard deviations', own.albedo, tell),
    );
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
  set.append(legend);
  for (let i = 0; i < Math.min(SHOWN, values.length); i += 1) {
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
    set.append(label);
  }
  return set;
}
