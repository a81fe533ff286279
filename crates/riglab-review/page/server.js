// Talks to the server. Decisions go one after the other, in the order in which they were taken.

let last = Promise.resolve();
let open = 0;

export async function load() {
  const answer = await fetch("assets");
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

// Resolves when the decision is on the disk: it is `asset.saved` then. Fails with a sentence, and where another window decided
// since `asset.saved` with what that one decided (`newer`), which is `asset.saved` from then on. Decisions that were waiting
// then fail the same way unsent: who took them had not seen it.
export function decide(asset, decision) {
  open += 1;
  const seen = asset.newer;
  const done = last.then(() => (asset.newer === seen ? send(asset, decision) : Promise.reject(elsewhere(asset))));
  last = done.catch(() => {}).then(() => { open -= 1; });
  return done;
}

function elsewhere(asset) {
  const said = `${asset.name} was decided in another window in the meantime. That decision is shown now and yours was not saved: decide again to change it.`;
  return Object.assign(new Error(said), { newer: asset.saved });
}

// Browsers take no more along when a page closes.
const KEPT_ALIVE = 64 << 10;

async function send(asset, decision) {
  const body = new Blob([JSON.stringify({ name: asset.name, digest: asset.digest, ...decision, was: asset.saved })]);
  let answer;
  try {
    // Outlives the page where it can: what was typed last is sent while it closes.
    const headers = { "Content-Type": "application/json" };
    answer = await fetch("decide", { method: "POST", headers, body, keepalive: body.size <= KEPT_ALIVE });
  } catch {
    throw new Error("The server does not answer; the last decision was not saved. Start riglab review again and open the address it prints: all that was saved is there.");
  }
  if (answer.status === 409 && answer.headers.get("Content-Type") === "application/json") {
    asset.saved = (await answer.json()).newer;
    asset.newer += 1;
    throw elsewhere(asset);
  }
  if (!answer.ok) throw new Error(`Not saved: ${(await answer.text()).trim()}`);
  asset.saved = decision;
}

export const pending = () => open;

const dark = matchMedia("(prefers-color-scheme: dark)");
export const picture = (index, size) => `picture/${index}/${size}-${dark.matches ? "dark" : "light"}.png`;
