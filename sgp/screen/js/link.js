// The link to the station: states arrive, actions are sent. The page is one of possibly several.

// A reload keeps its name, and with it the control; a copy of the tab gets another one.
const PAGE = sessionStorage.page ?? crypto.randomUUID();
delete sessionStorage.page;
addEventListener("pagehide", () => (sessionStorage.page = PAGE));

/** Call `changed(state)` for each state, and `lost()` while the station does not answer. */
export function listen(changed, lost) {
  const source = new EventSource(`events?page=${PAGE}`);
  source.onmessage = (event) => changed(JSON.parse(event.data));
  source.onerror = lost;
}

let last = Promise.resolve();

/** Ask the station for something, a stop at once, all else in order; returns an error text, or "" if it was done. */
export function ask(action) {
  if (action.do === "stop") return send(action);
  last = last.then(() => send(action));
  return last;
}

async function send(action) {
  try {
    const answer = await fetch("do", {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-Page": PAGE },
      body: JSON.stringify(action),
    });
    return answer.ok ? "" : (await answer.json()).error;
  } catch {
    return "the station does not answer: is the program still running?";
  }
}
