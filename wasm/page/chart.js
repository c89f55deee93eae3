/** The likelihood's trace: both stages, each on its own scale, since they measure other things. */

import { context } from './dom.js';

/**
 * @param {HTMLCanvasElement} canvas
 * @param {ArrayLike<number>} trace Step and value by turns.
 * @param {number} boundary Step at which the image stage begins.
 * @param {number} total Steps in all.
 */
export function drawTrace(canvas, trace, boundary, total) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const draw = context(canvas);
  const style = getComputedStyle(canvas);
  draw.scale(ratio, ratio);
  draw.font = `12px ${style.fontFamily}`;
  draw.fillStyle = style.getPropertyValue('--faint');
  draw.strokeStyle = style.getPropertyValue('--accent');
  draw.lineWidth = 1.5;
  draw.lineJoin = 'round';
  const split = (boundary / Math.max(total, 1)) * width;
  const stages = [
    { name: 'pose by landmarks', from: 0, to: split, first: 0, last: boundary },
    { name: 'everything by the photo', from: split, to: width, first: boundary, last: total },
  ];
  for (const { name, from, to, first, last } of stages) {
    const points = [];
    for (let i = 0; i < trace.length; i += 2) {
      // The boundary's own point is the image stage's.
      if (trace[i] >= first && (trace[i] < last || last === total)) points.push([trace[i], trace[i + 1]]);
    }
    draw.fillText(name, from + 4, height - 4, to - from - 8);
    // The first values are far below all others: they would make a wall and a flat line.
    const sorted = points.map(([, value]) => value).sort((a, b) => a - b);
    const [low, high] = [sorted[Math.floor(0.05 * sorted.length)], sorted.at(-1)];
    if (low === undefined || high === undefined) continue;
    const y = (/** @type {number} */ value) => {
      const share = (Math.max(value, low) - low) / Math.max(high - low, 1e-9);
      return height - 20 - share * (height - 26);
    };
    draw.beginPath();
    for (const [step, value] of points) {
      draw.lineTo(from + ((step - first) / Math.max(last - first, 1)) * (to - from), y(value));
    }
    draw.stroke();
  }
  draw.fillRect(split, 0, 1, height);
}
