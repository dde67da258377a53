// A connection that comes back by itself. Each message has one answer.
//
// connect(open, on): open() returns a channel like a WebSocket: send(text), close(), readyState,
// and onopen, onmessage({data}), onclose({reason}) to be set. `on` has hello(), the first message
// of a connection; heard(answer); down(why), the connection is lost and will be tried again.
const SILENT = 1500, // [ms] without an answer that is due: the connection is dead
  MOST_WAIT = 2000; // [ms] between two tries

export function connect(open, on) {
  let channel = null,
    unanswered = 0,
    due = Infinity,
    wait = 100,
    timer = 0;

  function start() {
    channel = open();
    unanswered = 0;
    due = performance.now() + 2 * SILENT;
    channel.onopen = () => send(on.hello());
    channel.onmessage = ({ data }) => {
      const answer = JSON.parse(data);
      unanswered -= 1;
      due = unanswered > 0 ? performance.now() + SILENT : Infinity;
      if (answer.trouble) return again(answer.trouble);
      wait = 100;
      on.heard(answer);
    };
    channel.onclose = ({ reason }) => again(reason);
  }

  function leave() {
    channel.onopen = channel.onmessage = channel.onclose = null;
    channel.close();
    due = Infinity;
  }

  // A connection that closed, is silent or in trouble is not waited for: the next one is tried.
  function again(why) {
    leave();
    on.down(why);
    timer = setTimeout(start, wait);
    wait = Math.min(2 * wait, MOST_WAIT);
  }

  function send(message) {
    if (channel.readyState !== 1) return;
    channel.send(JSON.stringify(message));
    unanswered += 1;
    due = Math.min(due, performance.now() + SILENT);
  }

  const watch = setInterval(() => performance.now() > due && again(""), 100);
  start();

  function stop() {
    clearInterval(watch);
    clearTimeout(timer);
    leave();
  }
  return { send, stop };
}
