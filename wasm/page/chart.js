/** The likelihood's trace: each stage on its own scale, since they measure other things. */

import { context } from './dom.js';

/**
 * @param {HTMLCanvasElement} canvas
 * @param {ArrayLike<number>} trace Step and value by turns.
 * @param {{ name: string, steps: number }[]} schedule The stages, in order.
 */
export function drawTrace(canvas, trace, schedule) {
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
  const total = schedule.reduce((sum, { steps }) => sum + steps, 0);
  let last = 0;
  for (const { name, steps } of schedule) {
    const first = last;
    last += steps;
    const [from, to] = [first, last].map((step) => (step / Math.max(total, 1)) * width);
    if (first > 0) draw.fillRect(from, 0, 1, height);
    if (steps === 0) continue;
    const points = [];
    for (let i = 0; i < trace.length; i += 2) {
      // A boundary's own point is the later stage's.
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
}
