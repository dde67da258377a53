// Figures are explored within the page: zoomed, moved, and read off at a cross, by pointer or
// keyboard. Panels and named
// lines are found in the drawing itself, where they have their limits and names as ids
// (descriptions.py). On a narrow screen
// the panels of a figure come one below the other; what is still too small to read there is
// scrolled sideways. Without this
// script each figure stands there as drawn.
const NARROW = matchMedia("(max-width: 40rem)");
const LEAST_PICTURE = 640; // px: of a picture without points, such as a photograph of a screen
const NEAR = 0.04; // of the figure's width: a line this close to the cross is read off
const drawings = new WeakMap();

function drawing(image) {
  if (!drawings.has(image)) {
    const bytes = Uint8Array.from(atob(image.src.split(",")[1]), (letter) => letter.charCodeAt(0));
    const svg = new DOMParser().parseFromString(
      new TextDecoder().decode(bytes),
      "image/svg+xml",
    ).documentElement;
    const [, , width, height] = svg.getAttribute("viewBox").split(/\s+/).map(Number);
    drawings.set(image, {
      svg,
      width,
      height,
      panels: [...svg.querySelectorAll('g[id^="{"]')].map(panel),
    });
  }
  return drawings.get(image);
}

function points(path) {
  const numbers = (path?.getAttribute("d").match(/-?\d+(\.\d+)?/g) ?? []).map(Number);
  return Array.from({ length: numbers.length >> 1 }, (_, i) => [
    numbers[2 * i],
    numbers[2 * i + 1],
  ]);
}

function panel(group) {
  const corners = points(group.querySelector("path"));
  const [xs, ys] = [0, 1].map((side) => corners.map((corner) => corner[side]));
  const lines = [...group.parentNode.querySelectorAll('g[id^="line:"]')];
  return {
    left: Math.min(...xs),
    right: Math.max(...xs),
    top: Math.min(...ys),
    bottom: Math.max(...ys),
    ...JSON.parse(group.id),
    lines: lines.map((line) => ({
      name: line.id.slice(5),
      points: points(line.querySelector("path")),
    })),
  };
}

const along = ([low, high, scale], share) =>
  scale === "log" ? low * (high / low) ** share : low + (high - low) * share;
const short = (value) => Number(value.toPrecision(3)).toString().replace("-", "−");

function reading({ panels, width }, x, y) {
  const here = panels.find(
    (one) => one.left <= x && x <= one.right && one.top <= y && y <= one.bottom,
  );
  if (!here) return "";
  const across = (at) => short(along(here.x, (at - here.left) / (here.right - here.left)));
  const up = (at) => short(along(here.y, (here.bottom - at) / (here.bottom - here.top)));
  const words = [`${here.x[3]}: ${across(x)}; ${here.y[3]}: ${up(y)}`];
  for (const line of here.lines) {
    const distance = (point) => Math.abs(point[0] - x);
    const nearest = line.points.reduce(
      (best, point) => (distance(point) < distance(best) ? point : best),
      [Infinity, 0],
    );
    if (distance(nearest) < NEAR * width && Math.abs(nearest[1] - y) < NEAR * width)
      words.push(`${line.name}: ${up(nearest[1])} at ${across(nearest[0])}`);
  }
  return words.join(" · ");
}

function explore(view, image, told) {
  const drawn = drawing(image);
  const at = { scale: 1, x: 0, y: 0, cross: [0.5, 0.5] };
  const cross = make("i", { className: "cross" });
  view.append(cross);
  const within = (value, low, high) => Math.min(Math.max(value, low), high);
  const show = () => {
    const { clientWidth: width, clientHeight: height } = view;
    at.x = within(at.x, 0, width * (at.scale - 1));
    at.y = within(at.y, 0, height * (at.scale - 1));
    image.style.transform = `translate(${-at.x}px, ${-at.y}px) scale(${at.scale})`;
    const [left, top] = [
      at.cross[0] * width * at.scale - at.x,
      at.cross[1] * height * at.scale - at.y,
    ];
    cross.style.transform = `translate(${left}px, ${top}px)`;
    told.textContent = reading(drawn, at.cross[0] * drawn.width, at.cross[1] * drawn.height);
  };
  const zoom = (factor, [x, y] = at.cross) => {
    const { clientWidth: width, clientHeight: height } = view;
    const scale = within(at.scale * factor, 1, 20);
    at.x += x * width * (scale - at.scale);
    at.y += y * height * (scale - at.scale);
    at.scale = scale;
    show();
  };
  const pointed = (event) => {
    const box = view.getBoundingClientRect();
    return [
      (event.clientX - box.left + at.x) / (box.width * at.scale),
      (event.clientY - box.top + at.y) / (box.height * at.scale),
    ];
  };
  const step = (x, y) => {
    const { clientWidth: width, clientHeight: height } = view;
    at.cross = [within(at.cross[0] + x / at.scale, 0, 1), within(at.cross[1] + y / at.scale, 0, 1)];
    at.x = within(at.x, (at.cross[0] * at.scale - 1) * width, at.cross[0] * at.scale * width);
    at.y = within(at.y, (at.cross[1] * at.scale - 1) * height, at.cross[1] * at.scale * height);
    show();
  };
  const reset = () => {
    Object.assign(at, { scale: 1, x: 0, y: 0 });
    show();
  };
  const keys = {
    ArrowLeft: () => step(-0.01, 0),
    ArrowRight: () => step(0.01, 0),
    ArrowUp: () => step(0, -0.01),
    ArrowDown: () => step(0, 0.01),
    "+": () => zoom(1.5),
    "-": () => zoom(1 / 1.5),
    0: reset,
  };
  view.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  view.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2, pointed(event));
    },
    { passive: false },
  );
  view.addEventListener("pointermove", (event) => {
    if (event.buttons) {
      at.x -= event.movementX;
      at.y -= event.movementY;
    }
    at.cross = pointed(event).map((share) => within(share, 0, 1));
    show();
  });
  addEventListener("resize", show);
  show();
  return { zoom, reset };
}

function explorable(figure) {
  const image = figure.querySelector('img[src^="data:image/svg+xml;base64,"]');
  if (!image) return;
  const button = (textContent, label, act) => {
    const made = make("button", { type: "button", textContent, ariaLabel: label, title: label });
    made.addEventListener("click", act);
    return made;
  };
  const bar = make("div", { className: "tools" });
  const start = button("explore", "explore this figure: zoom, and read values off", () => {
    const view = make("div", { className: "view", tabIndex: 0, role: "application" });
    view.ariaLabel =
      "Figure to explore: arrow keys move the cross, plus and minus zoom, 0 shows the whole";
    (image.closest(".wide") ?? image).replaceWith(view);
    image.style.minWidth = "";
    view.append(image);
    const told = make("output", {});
    const { zoom, reset } = explore(view, image, told);
    bar.replaceChildren(
      button("+", "zoom in", () => zoom(1.5)),
      button("−", "zoom out", () => zoom(1 / 1.5)),
      button("whole", "show the whole figure", reset),
      told,
    );
    view.focus();
  });
  bar.append(start);
  figure.querySelector("figcaption").before(bar);
}

// The parts of a figure, each with its box and the ids of its groups: what belongs to all panels
// first, then every panel with
// its ticks and titles.
function parts(svg) {
  const shown = make("div", { className: "measured" });
  document.body.append(shown);
  const copy = shown.appendChild(document.importNode(svg, true));
  const box = (group) => {
    const { x, y, width, height } = group.getBBox();
    return [x, y, x + width, y + height];
  };
  const join = (a, b) => [
    Math.min(a[0], b[0]),
    Math.min(a[1], b[1]),
    Math.max(a[2], b[2]),
    Math.max(a[3], b[3]),
  ];
  const around = (groups) =>
    groups
      .map(box)
      .filter((one) => one[2] > one[0])
      .reduce(join, [Infinity, Infinity, -Infinity, -Infinity]);
  const common = [],
    panels = [];
  let solid = []; // of a panel in three dimensions: its sides come before it
  for (const group of copy.querySelector("#figure_1")?.children ?? []) {
    if (/^(text|legend|trustlab)/.test(group.id)) common.push({ box: box(group), ids: [] });
    if (/^(pane|grid|axis)3d/.test(group.id)) solid.push(group);
    if (!group.id.startsWith("axes")) continue;
    const own = [...group.children].filter((child) =>
      /^(\{|matplotlib|text|legend|trustlab)/.test(child.id),
    );
    const ids = [...solid, group].map((one) => one.id),
      panel = around(solid.length ? [...solid, group] : own);
    solid = [];
    // A scale of colours stays with the panel beside it, a second axis with its own.
    const level = panels.filter((one) => one.box[1] < panel[3] && panel[1] < one.box[3]);
    const gap = (one) => (one.box[0] > panel[0] ? Infinity : panel[0] - one.box[2]);
    const beside = level.reduce(
      (best, one) => (best && gap(best) <= gap(one) ? best : one),
      undefined,
    );
    const joined =
      beside && (gap(beside) < -20 || panel[2] - panel[0] < 0.35 * (beside.box[2] - beside.box[0]));
    if (joined)
      Object.assign(beside, { box: join(beside.box, panel), ids: [...beside.ids, ...ids] });
    else if (panel[2] > panel[0]) panels.push({ box: panel, ids });
  }
  shown.remove();
  return { common: common.filter((one) => one.box[2] > one.box[0]), panels };
}

function reflow(figure) {
  const image = figure.querySelector('img[src^="data:image/svg+xml;base64,"]');
  if (!image || image.closest(".view, .wide")) return;
  const { svg, width } = drawing(image);
  const { common, panels } = parts(svg);
  const boxes = panels.map((one) => one.box);
  const columns = boxes.some((one, i) =>
    boxes.some((other, j) => j > i && (other[0] > one[2] - 20 || one[0] > other[2] - 20)),
  );
  if (!columns || image.clientWidth > width) return;
  const each = make("div", { className: "panels", role: "img", ariaLabel: image.alt });
  for (const {
    box: [left, top, right, bottom],
    ids,
  } of [...common, ...panels]) {
    const part = svg.cloneNode(true);
    // Ticks and titles of its neighbours may reach into the box of a panel. They are hidden, not
    // removed: their letters are used by all.
    for (const group of part.querySelector("#figure_1").children)
      if (/^(axes|(pane|grid|axis)3d)/.test(group.id) && !ids.includes(group.id))
        group.setAttribute("visibility", "hidden");
    const size = [left - 3, top - 3, right - left + 6, bottom - top + 6];
    part.setAttribute("viewBox", size.join(" "));
    part.setAttribute("width", `${size[2]}pt`);
    part.setAttribute("height", `${size[3]}pt`);
    const source = new XMLSerializer().serializeToString(part);
    each.append(
      make("img", {
        alt: "",
        src: `data:image/svg+xml;charset=utf-8,${encodeURIComponent(source)}`,
      }),
    );
  }
  image.replaceWith(each);
  NARROW.addEventListener("change", () => each.replaceWith(image), { once: true });
}

// A figure that stays whole is at least as many pixels wide as its drawing has points: its letters
// of 8 pt then come to 8 px.
// Where that is wider than the page it is scrolled sideways.
function scrolled(figure) {
  const image = figure.querySelector('img[src^="data:image/"]');
  if (!image || image.closest(".view, .wide, .panels")) return;
  const least = image.src.startsWith("data:image/svg") ? drawing(image).width : LEAST_PICTURE;
  if (image.clientWidth >= least) return;
  const wide = make("div", {
    className: "wide",
    tabIndex: 0,
    role: "region",
    ariaLabel: "figure, scrolled sideways",
  });
  image.replaceWith(wide);
  wide.append(image);
  image.style.minWidth = `${least}px`;
  NARROW.addEventListener(
    "change",
    () => {
      image.style.minWidth = "";
      wide.isConnected && wide.replaceWith(image);
    },
    { once: true },
  );
}

addEventListener("DOMContentLoaded", () => {
  const figures = [...document.querySelectorAll("main figure")];
  figures.forEach(explorable);
  const fit = () =>
    NARROW.matches &&
    figures.forEach((figure) => {
      reflow(figure);
      scrolled(figure);
    });
  NARROW.addEventListener("change", fit);
  fit();
});
