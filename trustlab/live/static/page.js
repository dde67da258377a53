// Elements, words and styles of a page.

export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

// The gamepad that is connected, if one is, and where its stick is, in [−1, 1] on both axes.
export const gamepad = () =>
  [...(navigator.getGamepads?.() ?? [])].find((pad) => pad?.connected) ?? null;

export function stick(pad) {
  const still = (x) => (Math.abs(x ?? 0) < 0.08 ? 0 : clamp(x, -1, 1));
  return pad ? [still(pad.axes[0]), -still(pad.axes[1])] : [0, 0];
}

// Draw a line through points.
export function stroke(g, colour, width, ...points) {
  g.strokeStyle = colour;
  g.lineWidth = width;
  g.beginPath();
  for (const point of points) g.lineTo(...point);
  g.stroke();
}

// Say what is wrong at the top of the page; nothing where words are empty.
export function complain(words) {
  Object.assign(document.getElementById("trouble"), { textContent: words, hidden: !words });
}

// The options of a request that carries a body.
export const posted = (body) => ({
  method: "POST",
  body: JSON.stringify(body),
  headers: { "Content-Type": "application/json" },
});

// Words that stand there already would be laid out again.
export function say(place, words) {
  if (place.textContent !== words) place.textContent = words;
}

// A text with {names} in it, filled in.
export function filled(text, values) {
  return text.replace(/\{(\w+)\}/g, (hole, name) => values[name] ?? hole);
}

// Notebooks look for shortcuts before an element hears of a key, but not for elements that say so:
// an x would cut the cell. The element that has the focus must say it itself.
export function keepKeys(...focusable) {
  for (const part of focusable) part.dataset.lmSuppressShortcuts = "true";
}

// Give an element's document, or its shadow root, a style sheet; an element that is not attached
// yet has none that could take it.
export function addStyle(root, css) {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(css);
  const put = () => {
    const home = root.getRootNode();
    if ("adoptedStyleSheets" in home)
      home.adoptedStyleSheets = [...home.adoptedStyleSheets, sheet];
    else requestAnimationFrame(put);
  };
  put();
}
