/** Addresses of scripts, for pages that let none run but by a policy (Trusted Types). */

/** @type {{ createScriptURL(url: string): string } | undefined} */
let policy;

/** The address of a script of the page's own origin, as the browser wants it. @param {URL | string} url */
export function scriptUrl(url) {
  const { trustedTypes } = /** @type {any} */ (globalThis);
  policy ??= trustedTypes?.createPolicy('onescan', { createScriptURL: own });
  return policy?.createScriptURL(String(url)) ?? String(url);
}

/** @param {string} url */
function own(url) {
  if (new URL(url, location.href).origin !== location.origin) throw new Error(`${url} is another site's`);
  return url;
}
