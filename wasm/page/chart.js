/** The energy's course: each level on its own scale, since their energies measure other things. */

import { context } from './dom.js';

/**
 * @param {HTMLCanvasElement} canvas
 * @param {import('../js/onescan.js').TracePoint[]} trace
 * @param {import('../js/onescan.js').Level[]} levels
 */
export function drawTrace(canvas, trace, levels) {
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
  const total = levels.reduce((sum, { steps }) => sum + steps, 0);
  let steps = 0;
  levels.forEach(({ blur, steps: own }, level) => {
    const [from, to] = [steps, steps + own].map((step) => (step / total) * width);
    steps += own;
    if (level > 0) draw.fillRect(from, 0, 1, height);
    const photo = level + 1 < levels.length ? 'sharp' : 'the photo itself';
    draw.fillText(blur > 0 ? `${blur} px` : photo, from + 4, height - 4, to - from - 8);
    const energies = trace.filter((point) => point.level === level).map(({ energy }) => energy);
    const [low, high] = [Math.min(...energies), Math.max(...energies)];
    draw.beginPath();
    energies.forEach((energy, i) => {
      const x = from + ((i + 0.5) / own) * (to - from);
      const y = height - 20 - ((energy - low) / Math.max(high - low, 1e-9)) * (height - 26);
      draw.lineTo(x, y);
      if (energies.length === 1) draw.lineTo(x + 1, y);
    });
    draw.stroke();
  });
}
