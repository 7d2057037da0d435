// Asks the daemon, with the token where it wants one.
let asking = null;
function askToken() {
  const dialog = document.getElementById("ask-token"), token = document.getElementById("token");
  asking ??= new Promise((done) => {
    dialog.showModal();
    dialog.addEventListener("close", () => { sessionStorage.setItem("token", token.value); asking = null; done(); }, { once: true });
  });
  return asking;
}

export async function ask(path, options = {}) {
  const token = sessionStorage.getItem("token"), headers = { ...(options.headers || {}) };
  if (token) headers.Authorization = `Bearer ${token}`;
  if (options.json !== undefined) { headers["Content-Type"] = "application/json"; options.body = JSON.stringify(options.json); options.method = "POST"; }
  const reply = await fetch(path, { ...options, headers, cache: "no-store" });
  if (reply.status === 401) { await askToken(); return ask(path, options); }
  if (!reply.ok) throw new Error((await reply.json().catch(() => null))?.error?.message || `${path}: ${reply.status}`);
  return reply;
}
