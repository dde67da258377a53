// Elements, words and styles of a page.

export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

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
export function dress(root, css) {
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
