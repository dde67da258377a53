// Numbered rows on their way to a disk: kept in IndexedDB apart from sending, sent again until they
// are acknowledged.  A row is [k, ms, ...values]: its number from 0, the page's clock when it was
// made, and what was logged. `send(rows)` gets the rows that are not yet acknowledged, at most 600
// and in order, and returns how many rows (from 0 on, without a gap) are on the disk of the other
// side, or a promise of that; undefined where it does not know, and then `acknowledged(n)` may be
// called later. Without `send` rows are only kept, until they are dropped.

const NAME = "trustlab-live",
  STORE = "rows",
  MOST = 600;

const opened = new Promise((ok) => {
  try {
    const request = indexedDB.open(NAME, 1);
    request.onupgradeneeded = () => request.result.createObjectStore(STORE);
    request.onsuccess = () => ok(request.result);
    request.onerror = request.onblocked = () => ok(null);
  } catch {
    ok(null); // a private window may have none: rows are then in memory only
  }
});

// Do something with the store; "strict" means that the browser waits for the disk, so that its own
// death loses nothing.
async function kept(mode, work, durability = "strict") {
  const database = await opened;
  if (!database) return undefined;
  return new Promise((ok) => {
    const transaction = database.transaction(STORE, mode, { durability });
    const request = work(transaction.objectStore(STORE));
    transaction.oncomplete = () => ok(request?.result);
    transaction.onerror = transaction.onabort = () => ok(undefined);
  });
}

const between = (key, first, end) => IDBKeyRange.bound([key, first], [key, end], false, true);

export class Rows {
  // key: names these rows among all that this browser keeps. every: ms between sendings.
  // leave(rows): send without waiting, as the page is being left (a request that outlives it).
  constructor(key, send, { every = 500, leave = null } = {}) {
    this.key = key;
    this.send = send;
    this.waiting = new Map(); // number → row, not yet acknowledged
    this.unkept = []; // rows not yet handed to IndexedDB
    this.have = -1; // rows that the other side has, where it has said so
    this.busy = false;
    this.keeping = Promise.resolve();
    this.ready = kept("readonly", (store) => store.getAll(between(key, 0, Infinity))).then(
      (rows) => {
        for (const row of rows ?? []) this.waiting.set(row[0], row);
      },
    );
    this.timer = setInterval(() => this.flush(), every);
    this.leaving = () => {
      this.keep();
      if (this.waiting.size) leave?.(this.next());
    };
    addEventListener("pagehide", this.leaving);
    document.addEventListener("visibilitychange", this.leaving);
  }

  add(k, values) {
    const row = [k, Math.round(performance.now() * 10) / 10, ...values];
    this.waiting.set(k, row);
    this.unkept.push(row);
  }

  // How many rows wait for their acknowledgement.
  pending() {
    return this.waiting.size;
  }

  // Rows 0 to n − 1 are on the other side's disk.
  async acknowledged(n) {
    this.have = Math.max(this.have, n);
    for (const k of this.waiting.keys()) if (k < n) this.waiting.delete(k);
    this.unkept = this.unkept.filter((row) => row[0] >= n);
    await this.keeping;
    // Not at once: a row that comes back after a crash is one that the other side has.
    await kept("readwrite", (store) => store.delete(between(this.key, 0, n)), "relaxed");
  }

  // The rows to send next: the oldest that wait.
  next() {
    return [...this.waiting.values()].sort((a, b) => a[0] - b[0]).slice(0, MOST);
  }

  keep() {
    const fresh = this.unkept;
    this.unkept = [];
    if (!fresh.length) return;
    this.keeping = kept("readwrite", (store) => {
      for (const row of fresh) store.put(row, [this.key, row[0]]);
    });
  }

  async flush() {
    this.keep(); // not behind a sending that hangs
    if (!this.send || this.busy || !this.waiting.size) return;
    this.busy = true;
    try {
      const have = await this.send(this.next());
      if (Number.isInteger(have)) await this.acknowledged(have);
    } catch {
      // The other side is away; the next flush tries again.
    } finally {
      this.busy = false;
    }
  }

  // Return when all rows are acknowledged, those of an earlier page with this key included.
  async drain() {
    await this.ready;
    while (this.waiting.size && this.timer) {
      const before = this.waiting.size;
      await this.flush();
      const [first] = this.next();
      // Rows between are gone for good
      if (first && this.have >= 0 && first[0] > this.have) return this.drop();
      if (this.waiting.size === before) await new Promise((ok) => setTimeout(ok, 200));
    }
    this.close();
  }

  close() {
    this.keep(); // for the page that goes on with this key
    clearInterval(this.timer);
    this.timer = null;
    removeEventListener("pagehide", this.leaving);
    document.removeEventListener("visibilitychange", this.leaving);
  }

  // Forget what waits: the other side has said that it will not take it.
  async drop() {
    this.close();
    this.waiting.clear();
    this.unkept = [];
    await this.keeping;
    await kept("readwrite", (store) => store.delete(between(this.key, 0, Infinity)));
  }

  // The keys, beginning with `prefix`, of rows that earlier pages left behind.
  static async left(prefix) {
    const keys = (await kept("readonly", (store) => store.getAllKeys())) ?? [];
    return [...new Set(keys.map(([key]) => key))].filter((key) => key.startsWith(prefix));
  }
}
