// Pictures that come late and unevenly, shown evenly. Times are in periods of the task: picture k
// shows what the first k commands led to.
import { clamp } from "./page.js";

const LAGS = 100, // pictures that the delay is taken from
  LATE = 0.03, // share of them that may come too late to be shown in time
  SLOWER = 0.25, // how much slower time is shown while the delay grows
  FASTER = 0.2; // and how much faster while it shrinks

function between(a, b, share) {
  if (Array.isArray(a) && Array.isArray(b)) return a.map((x, i) => between(x, b[i], share));
  return typeof a === "number" && typeof b === "number" ? a + share * (b - a) : a;
}

function turned(a, b, share) {
  return a + share * Math.atan2(Math.sin(b - a), Math.cos(b - a));
}

export class Playout {
  // `moving` names what is interpolated; all else stays until the next picture.
  constructor(moving, time) {
    Object.assign(this, { moving, past: [], lags: [], delay: 1, last: time, still: time });
  }

  // Keep a picture that came at a time.
  add(picture, time) {
    if (picture.k <= this.past.at(-1)?.k) return;
    this.past.push(picture);
    if (this.past.length > 60) this.past.shift();
    if (picture.k <= this.still) return; // an outage says nothing about the connection
    this.lags.push(time - picture.k);
    if (this.lags.length > LAGS) this.lags.shift();
  }

  // The delay with which the next picture is there when one is reached.
  get needed() {
    const lags = [...this.lags].sort((a, b) => a - b);
    return 1 + (lags[Math.ceil((1 - LATE) * lags.length) - 1] ?? 0);
  }

  // Let the time go on; the delay follows the connection, slowly.
  tick(time) {
    const step = Math.max(time - this.last, 0),
      missing = this.needed - this.delay;
    this.delay += clamp(missing, -FASTER * step, SLOWER * step);
    this.delay = Math.max(this.delay, time - this.past.at(-1).k); // no picture is skipped
    this.last = time;
  }

  // The picture of some time ago: of the delay, or of `least` if that is more.
  at(time, least) {
    const { past } = this,
      shown = time - Math.max(this.delay, least),
      i = Math.max(
        past.findLastIndex(({ k }) => k <= shown),
        0,
      ),
      a = past[i],
      b = past[i + 1] ?? a,
      share = clamp((shown - a.k) / Math.max(b.k - a.k, 1), 0, 1),
      picture = { ...a, shown };
    for (const name of this.moving) {
      const mix = name === "yaw" ? turned : between;
      if (b[name] !== null) picture[name] = mix(a[name], b[name], share);
    }
    return picture;
  }
}
