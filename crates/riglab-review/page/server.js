// Talks to the server. Decisions go one after the other, in the order in which they were taken.

let last = Promise.resolve();
let open = 0;

export async function load() {
  const answer = await fetch("assets");
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

// Resolves when the decision is on the disk; fails with a sentence, and where another window decided since `was` with what
// that one decided (`newer`).
export function decide(asset, decision, was) {
  open += 1;
  const sent = { name: asset.name, digest: asset.digest, ...decision, was };
  const done = last.then(() => send(sent));
  last = done.catch(() => {}).then(() => { open -= 1; });
  return done;
}

async function send(decision) {
  let answer;
  try {
    // Outlives the page: what was typed last is sent while it closes.
    const headers = { "Content-Type": "application/json" };
    answer = await fetch("decide", { method: "POST", headers, body: JSON.stringify(decision), keepalive: true });
  } catch {
    throw new Error("The server does not answer; the last decision was not saved. Start riglab review again and open the address it prints: all that was saved is there.");
  }
  if (answer.status === 409 && answer.headers.get("Content-Type") === "application/json") {
    const { newer } = await answer.json();
    throw Object.assign(new Error(`${decision.name} was decided in another window in the meantime. That decision is shown now and yours was not saved: decide again to change it.`), { newer });
  }
  if (!answer.ok) throw new Error(`Not saved: ${(await answer.text()).trim()}`);
}

export const pending = () => open;

const dark = matchMedia("(prefers-color-scheme: dark)");
export const picture = (index, size) => `picture/${index}/${size}-${dark.matches ? "dark" : "light"}.png`;
