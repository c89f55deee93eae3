/** Names of landmarks: which a fit of a face uses, and how a person says them. */

/** The reference engine's, as `onescan demo` uses them. */
const FACE = [
  'right.eyebrow.bend.lower',
  'right.eyebrow.inner_lower',
  'left.eyebrow.inner_lower',
  'left.eyebrow.bend.lower',
  'right.eye.corner_outer',
  'right.eye.corner_inner',
  'left.eye.corner_inner',
  'left.eye.corner_outer',
  'right.nose.wing.tip',
  'center.nose.tip',
  'left.nose.wing.tip',
  'right.lips.corner',
  'center.lips.upper.outer',
  'left.lips.corner',
  'center.lips.lower.outer',
  'center.chin.tip',
];

/** The most a fit takes. */
const MOST = 64;

/** Whether a model is one of faces. @param {string[]} names */
export function isFace(names) {
  return FACE.every((name) => names.includes(name));
}

/** The landmarks to set on a photo for a model. @param {string[]} names Of the model. */
export function wanted(names) {
  return isFace(names) ? FACE : names.slice(0, MOST);
}

/** `right.eye.corner_outer` as "right eye corner outer". @param {string} name */
export function spoken(name) {
  return name.replace(/^center\./, '').replace(/[._]/g, ' ');
}
