// The page: follows the stream of readings, shows state and picture, changes settings.
import { ask } from "/server.js";
import { own, superscript, timeText, unitText } from "/text.js";

const $ = (id) => document.getElementById(id);
const root = document.documentElement;
const state = { status: null, curve: undefined, span: 3600, end: null, latest: new Map(), faults: new Map(), events: [], frame: null, busy: false, drag: null, last: 0, heard: 0, online: false };
const panels = new Map();
const EVENTS_KEPT = 300;
const MEANING = {
  saturated: "pixels clip: the value is a lower bound", below_noise: "not above the noise: an upper limit",
  extrapolated: "beyond the measured part of the response curve", flicker: "exposures disagree: the light flickers or moves",
  stale_calibration: "the calibration is too old", uncalibrated: "relative values: no calibration", nonuniform: "the patch is not uniform",
  exposure_unconfirmed: "the camera states another exposure time than it was given", repeated_frame: "the camera delivered the same frame again",
};

// ---- parts ----------------------------------------------------------------------------------------------------------
// Each part is drawn by itself: one that fails is named among the alarms, stops no other, and is tried again.
function part(name, draw) {
  try {
    draw();
    if (state.faults.delete(name)) showAlarms();
  } catch (error) {
    console.warn(name, error);
    state.faults.set(name, `This page cannot show ${name}: ${error.message}. Reload it; the daemon itself goes on.`);
    showAlarms();
  }
}
const missing = (name) => () => { throw new Error(`${name} could not be loaded`); };
const { TrendPanel } = await import("/trends.js").catch(() => ({ TrendPanel: missing("trends.js") }));
const { drawRamp, drawResponse } = await import("/response.js").catch(() => ({ drawRamp: missing("response.js"), drawResponse: missing("response.js") }));

// ---- numbers -------------------------------------------------------------------------------------------------------
// As `radiometer.numbers`: two digits of the expanded uncertainty decide how many of the value are shown. A power of ten
// follows where they end before the point or far behind it.
function written(value, U) {
  if (value === null || !Number.isFinite(value)) return { value: "undefined", U: "", power: "" };
  const size = Math.max(Math.abs(value), U) || 1, first = U > 0 ? 1 - Math.floor(Math.log10(U)) : 4;
  const decimals = U > 0 && Math.round(U * 10 ** first) >= 100 ? first - 1 : first;
  const exponent = (U > 0 ? decimals < 0 || decimals > 7 : size < 1e-3 || size >= 1e5) ? Math.floor(Math.log10(size)) : 0;
  const shown = (x) => (x / 10 ** exponent).toFixed(U > 0 ? Math.max(0, decimals + exponent) : 4).replace(/^-(?=[0.]*$)/, "");
  return { value: shown(value), U: U > 0 ? shown(U) : "", power: exponent ? `·10${superscript(exponent)}` : "" };
}
// As on the terminal: where a power of ten follows, it belongs to both, (1.3420 ± 0.0029)·10⁵.
const joined = ({ value, U, power }) => (U && power ? `(${value} ± ${U})${power}` : `${value}${U ? ` ± ${U}` : ""}${power}`);
const withSuperscripts = (message) => message.replace(/\b(W|sr|m)(-[12])\b/g, (_, letter, power) => letter + superscript(power));
const ago = (s) => (s < 2 ? "now" : s < 90 ? `${Math.round(s)} s ago` : s < 5400 ? `${Math.round(s / 60)} min ago` : `${Math.round(s / 3600)} h ago`);

// ---- server --------------------------------------------------------------------------------------------------------
async function send(path, json) {
  const shown = state.status;
  try {
    const reply = await (await ask(path, { json })).json();
    $("refusal").textContent = "";
    // The stream brings every change as well. Where it was faster, it may have brought a newer state than this reply.
    if (reply.devices && state.status === shown) showStatus(reply);
    return reply;
  } catch (error) {
    $("refusal").textContent = error.message;
    if (state.status) showStatus(state.status);
    return null;
  }
}

async function follow() {
  for (;;) {
    try {
      const reply = await ask(`/readings/stream${state.last ? `?after=${state.last}` : ""}`);
      setOnline(true);
      showStatus(await (await ask("/status")).json());
      recall();
      const reader = reply.body.pipeThrough(new TextDecoderStream()).getReader();
      let rest = "";
      for (;;) {
        const { value, done } = await Promise.race([reader.read(), new Promise((_, fail) => setTimeout(() => fail(new Error("silent")), 20000))]);
        if (done) break;
        const parts = (rest + value).split("\n\n");
        rest = parts.pop();
        parts.forEach((block) => part("what the daemon sends", () => take(block)));
      }
    } catch { /* shown by setOnline; tried again below */ }
    setOnline(false);
    await new Promise((wait) => setTimeout(wait, 1000));
  }
}
function take(block) {
  const fields = Object.fromEntries(block.split("\n").filter((l) => !l.startsWith(":")).map((l) => [l.slice(0, l.indexOf(":")), l.slice(l.indexOf(":") + 2)]));
  if (!fields.data) return;
  const content = JSON.parse(fields.data);
  if (fields.event === "status") showStatus(content);
  else if (fields.event === "patch") { note(content); part("the patches", showPatches); freshTrends(); }
  else { note(content); showReading(content); }
}
function setOnline(online) {
  state.online = online;
  showAlarms();
  part("the lights", showLights);
}

// ---- readings ------------------------------------------------------------------------------------------------------
function note(reading) {
  state.latest.set(reading.name || "main", reading);
  state.last = reading.sequence; // the stream is in order; lower only where a new journal was begun
}
/** Show what was last read of the patches with names, where it is of the place that each has now. */
async function recall() {
  for (const [name, { patch }] of Object.entries(state.status?.patches || {})) {
    if (name === "main" || state.latest.has(name)) continue;
    try {
      const [reading] = await (await ask(`/readings?limit=1&stream=${encodeURIComponent(`patch ${name}`)}`)).json();
      const there = reading && ["x", "y", "width", "height"].every((side) => reading.patch[side] === patch?.[side]);
      if (there && !state.latest.has(name)) state.latest.set(name, reading);
    } catch { /* its next reading, then */ }
  }
  part("the patches", showPatches);
}
function showReading(reading) {
  part("the reading", () => showValue(reading));
  part("the patches", showPatches);
  freshTrends();
  part("the picture", refreshPicture);
}
function showValue(reading) {
  const { value, u, unit } = reading.radiance, k = reading.coverage_factor, U = (u || 0) * k, w = written(value, U);
  state.heard = Date.parse(reading.time);
  $("value").textContent = w.value + w.power;
  $("unit").textContent = unitText(unit);
  $("expanded").textContent = w.U ? `± ${w.U}${w.power}  (k = ${+k.toPrecision(3)}${reading.U_rel === null ? "" : `, ${(reading.U_rel * 100).toPrecision(2)} %`})` : "";
  const shownExposures = reading.exposures_s.slice(0, 6).map((t) => (t < 1e-3 ? `${+(t * 1e6).toPrecision(3)} µs` : t < 1 ? `${+(t * 1e3).toPrecision(3)} ms` : `${+t.toPrecision(3)} s`));
  $("exposures").textContent = shownExposures.join(", ") + (reading.exposures_s.length > 6 ? ` and ${reading.exposures_s.length - 6} more` : "");
  const l = reading.luminance;
  const lw = l && written(l.value, l.u * k);
  $("luminance").textContent = l ? `${joined(lw)} ${unitText(l.unit)}` : "";
  $("flags").replaceChildren(...(reading.flags.length ? reading.flags : [""]).map((flag) => {
    const chip = document.createElement("span");
    chip.textContent = flag ? flag.replace("_", " ") : "no flags";
    chip.title = own(MEANING, flag) || "";
    chip.className = flag ? "" : "clean";
    return chip;
  }));
  document.title = `${w.value}${w.power} ${unitText(unit)} · radiometer`;
  const live = document.querySelector(".live");
  live.classList.remove("fresh"); void live.offsetWidth; live.classList.add("fresh");
}

// ---- trends --------------------------------------------------------------------------------------------------------
const quantity = (value, U, unit) => `${joined(written(value, U))} ${unitText(unit)}`;
function hovered(panel, index) {
  const c = panel.columns, rows = c.value.map((v, i) => i).filter((i) => c.value[i] !== null);
  if (!rows.length) return "";
  if (index === null) {
    const count = rows.reduce((n, i) => n + c.count[i], 0), mean = (column) => rows.reduce((n, i) => n + column[i] * c.count[i], 0) / count;
    const low = Math.min(...rows.map((i) => c.low[i])), high = Math.max(...rows.map((i) => c.high[i]));
    const [from, to] = [low, high].map((v) => written(v, high - low));
    return `mean ${quantity(mean(c.value), mean(c.U), "").trim()} (k = ${c.coverage_factor}) · n = ${count}, ${from.value}${from.power === to.power ? "" : from.power} to ${to.value}${to.power}`;
  }
  return `${timeText(c.time[index], state.span)}   ${quantity(c.value[index], c.U[index], c.unit)}${c.count[index] > 1 ? `   mean of ${c.count[index]}` : ""}${c.flagged[index] ? `   ${c.flagged[index]} flagged` : ""}`;
}
const windowShown = () => { const until = state.end ?? Date.now() / 1000; return [until - state.span, until]; };
let trendsDue = 0, trendsBusy = false, trendsAgain = false;
async function freshTrends(now = false) {
  if (document.hidden || (!now && (trendsBusy || state.end !== null || Date.now() < trendsDue))) return;
  if (trendsBusy) { trendsAgain = true; return; }
  trendsBusy = true;
  do { trendsAgain = false; await refreshTrends(); } while (trendsAgain);
  trendsBusy = false;
}
async function refreshTrends() {
  trendsDue = Date.now() + Math.max(1500, Math.min(60000, state.span * 2));
  const names = Object.keys(state.status?.patches || { main: null }), [since, until] = windowShown();
  for (const [name, panel] of panels) if (!names.includes(name)) { panel.remove(); panels.delete(name); }
  part("the trends", () => { for (const name of names) if (!panels.has(name)) panels.set(name, new TrendPanel($("panels"), name, hovered)); });
  const iso = (at) => encodeURIComponent(new Date(at * 1000).toISOString());
  $("export").href = `/readings?format=csv&stream=all&since=${iso(since)}&until=${iso(until)}`;
  $("window").textContent = state.end === null ? "" : `${timeText(since, 7201)} to ${timeText(until, 7201)}`;
  $("now").setAttribute("aria-pressed", state.end === null);
  $("later").disabled = state.end === null;
  const events = await marked(since, until, iso);
  await Promise.all(names.map(async (name) => {
    try {
      const stream = encodeURIComponent(name === "main" ? "main" : `patch ${name}`), points = Math.max(200, Math.min(2000, Math.round($("panels").clientWidth)));
      const columns = await (await ask(`/trend?stream=${stream}&since=${iso(since)}&until=${iso(until)}&points=${points}`)).json();
      panels.get(name)?.show(columns, [since, until], own(state.status?.patches, name)?.limits, limitsSince(name), events);
    } catch { /* the next turn tries again */ }
  }));
}
// When the limits in force were set, in s; before all where that is not among the events at hand.
const limitsSince = (name) => Date.parse(state.events.find((e) => e.kind === "patch" && e.message.startsWith(`limits of ${name}: `))?.time ?? 0) / 1000;
async function marked(since, until, iso) {
  let known = state.events;
  // The newest are at hand; a time before them is asked for.
  if (known.length >= EVENTS_KEPT && Date.parse(known.at(-1).time) / 1000 > since) {
    try { known = await (await ask(`/events?limit=1000&since=${iso(since)}&until=${iso(until)}`)).json(); } catch { /* the newest, then */ }
  }
  return known.map((e) => ({ at: Date.parse(e.time) / 1000, kind: e.kind, message: withSuperscripts(e.message) })).filter((e) => e.at >= since && e.at <= until && ["alarm", "changed", "clock", "calibration", "remark", "light", "start", "stop"].includes(e.kind));
}
function setSpan(span) {
  state.span = span;
  document.querySelectorAll(".spans button").forEach((b) => b.setAttribute("aria-pressed", +b.dataset.span === span));
  localStorage.setItem("span", span);
  freshTrends(true);
}
document.querySelectorAll(".spans button").forEach((b) => b.addEventListener("click", () => setSpan(+b.dataset.span)));
function moveWindow(direction) {
  const end = (state.end ?? Date.now() / 1000) + direction * state.span / 2;
  state.end = end >= Date.now() / 1000 ? null : end;
  freshTrends(true);
}
$("earlier").addEventListener("click", () => moveWindow(-1));
$("later").addEventListener("click", () => moveWindow(1));
$("now").addEventListener("click", () => { state.end = null; freshTrends(true); });
setInterval(() => freshTrends(), 2000);

// ---- patches with names --------------------------------------------------------------------------------------------
let limited = null;
// A row stays the same element from reading to reading: whoever is on its button with the keyboard stays there.
function patchRow(name) {
  const known = [...$("patch-list").children].find((row) => row.dataset.patch === name);
  if (known) return known;
  const row = document.createElement("div"), button = document.createElement("button");
  row.dataset.patch = name;
  button.type = "button";
  button.setAttribute("aria-label", `Limits of ${name}`);
  button.addEventListener("click", () => askLimits(name, own(state.status?.patches, name)?.limits || { low: null, high: null }));
  row.append(document.createElement("b"), document.createElement("span"), button);
  return row;
}
function showPatches() {
  const patches = state.status?.patches || {}, shown = Object.keys(patches).map((name) => state.latest.get(name)).filter(Boolean);
  const units = new Set(shown.map((reading) => reading.radiance.unit)), factors = shown.map((reading) => reading.coverage_factor);
  const k = [...new Set([Math.min(...factors), Math.max(...factors)].map((factor) => +factor.toPrecision(2)))].join(" to ");
  $("patch-unit").textContent = [units.size === 1 ? unitText([...units][0]) : "", factors.length ? `k = ${k}` : ""].filter(Boolean).join(", ");
  const byAlarm = Object.entries(patches).sort(([, a], [, b]) => !!b.breached - !!a.breached);  // what is folded is well
  const rows = byAlarm.map(([name, entry]) => {
    const row = patchRow(name), [title, value, button] = row.children, reading = state.latest.get(name), { low, high } = entry.limits;
    row.className = `patch-row${entry.breached ? " bad" : ""}`;
    title.textContent = `${entry.breached ? "▲ " : ""}${name === "main" ? "patch" : name}`;
    value.textContent = reading ? quantity(reading.radiance.value, (reading.radiance.u || 0) * reading.coverage_factor, units.size > 1 ? reading.radiance.unit : "").trim() : "no reading yet";
    value.title = reading ? `${unitText(reading.radiance.unit)}, k = ${+reading.coverage_factor.toPrecision(3)}` : "";
    panels.get(name)?.now(state.end === null && reading ? value.textContent : "", entry.breached);
    button.textContent = low === null && high === null ? "limits" : [low === null ? "" : `≥ ${+low.toPrecision(4)}`, high === null ? "" : `≤ ${+high.toPrecision(4)}`].filter(Boolean).join(" · ");
    return row;
  });
  if (rows.length !== $("patch-list").children.length || rows.some((row, place) => row !== $("patch-list").children[place])) $("patch-list").replaceChildren(...rows);
  foldPatches(rows);
  if (state.frame) $("outlines").replaceChildren(...Object.entries(patches).filter(([name, e]) => name !== "main" && e.patch).map(([name, { patch, breached }]) => {
    const box = document.createElement("div"), { w, h } = state.frame;
    box.className = `outline${breached ? " bad" : ""}`; box.dataset.name = name;
    Object.assign(box.style, { left: `${(100 * patch.x) / w}%`, top: `${(100 * patch.y) / h}%`, width: `${(100 * patch.width) / w}%`, height: `${(100 * patch.height) / h}%` });
    return box;
  }));
}
/** Show as many rows as there is room for, and a button for the rest, which lets the page grow. */
function foldPatches(rows) {
  const list = $("patch-list"), button = $("patches-all"), open = root.classList.contains("all-patches");
  rows.forEach((row) => { row.hidden = false; });
  button.hidden = !open;
  const beyond = () => rows.filter((row, place) => place && row.offsetTop + row.offsetHeight > list.clientHeight + 1);
  if (!open && beyond().length) {
    button.hidden = false;  // first, for it takes room from the list
    beyond().forEach((row) => { row.hidden = true; });
  }
  button.textContent = open ? "fewer" : `all ${rows.length}`;
  button.setAttribute("aria-expanded", open);
}
$("patches-all").addEventListener("click", () => { root.classList.toggle("all-patches"); part("the patches", showPatches); });
new ResizeObserver(() => part("the patches", showPatches)).observe(document.querySelector(".card.patches"));
function askLimits(name, limits) {
  limited = name;
  const unit = state.latest.get(name)?.radiance.unit || limits.unit || "";
  $("limits-title").textContent = `Limits of ${name === "main" ? "the patch" : name}${unit ? ` in ${unitText(unit)}` : ""}`;
  $("limit-low").value = limits.low ?? ""; $("limit-high").value = limits.high ?? "";
  $("limit-delete").hidden = name === "main";
  $("limits").returnValue = "cancel";
  $("limits").showModal();
}
$("limits").addEventListener("close", async () => {
  const number = (id) => ($(id).value === "" ? null : +$(id).value);
  let status = null;
  if ($("limits").returnValue === "save") status = await send("/patches", { name: limited, limits: { low: number("limit-low"), high: number("limit-high") } });
  if ($("limits").returnValue === "delete") { status = await send("/patches/delete", { name: limited }); state.latest.delete(limited); }
  if (status) freshTrends(true);
});
$("name-patch").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (!state.frame) return;
  const status = await send("/patches", { name: $("patch-name").value.trim(), patch: current() });
  if (status) { $("patch-name").value = ""; freshTrends(true); }
});

// ---- events --------------------------------------------------------------------------------------------------------
const KINDS = { cleared: "over" };
let eventsDue = null;
function refreshEvents() {
  eventsDue ??= setTimeout(async () => {  // a moment later: the journal has it then, and several changes are one request
    eventsDue = null;
    try {
      const newest = state.events[0]?.time;
      state.events = (await (await ask(`/events?limit=${EVENTS_KEPT}`)).json()).reverse();
      if (state.events[0]?.time !== newest) { showEvents(); freshTrends(true); }
    } catch { /* the next change tries again */ }
  }, 500);
}
function eventRows(events) {
  return events.map((event) => {
    const row = document.createElement("li"), t = document.createElement("time"), kind = document.createElement("span"), text = document.createElement("span");
    const day = new Date(event.time);
    t.dateTime = event.time; const today = day.toDateString() === new Date().toDateString();
    t.textContent = today ? day.toLocaleTimeString([], { hour12: false }) : `${day.toLocaleDateString([], { day: "numeric", month: "short" })} ${day.toLocaleTimeString([], { hour12: false, hour: "2-digit", minute: "2-digit" })}`;
    t.title = day.toLocaleString([], { hour12: false });
    kind.className = `kind is-${event.kind}`; kind.textContent = own(KINDS, event.kind) || event.kind;
    text.textContent = withSuperscripts(event.message);
    row.append(t, kind, text);
    return row;
  });
}
/** Show as many of the newest events as there is room for. */
function showEvents() {
  const list = $("event-list");
  $("events-all").hidden = !state.events.length;  // first, for it takes room from the list
  list.replaceChildren(...eventRows(state.events.slice(0, 100)));
  const room = list.clientHeight;
  [...list.children].filter((row, place) => place && row.offsetTop + row.offsetHeight > room).forEach((row) => row.remove());
  if (!state.events.length) { const none = document.createElement("li"); none.className = "quiet"; none.textContent = "nothing has happened yet"; $("event-list").append(none); }
}
$("events-all").addEventListener("click", () => { $("all-event-list").replaceChildren(...eventRows(state.events)); $("all-events").showModal(); });
new ResizeObserver(() => part("the events", showEvents)).observe(document.querySelector(".card.events"));
$("remark-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (await send("/events", { message: $("remark").value })) { $("remark").value = ""; refreshEvents(); }
});

setInterval(() => {
  const age = (Date.now() - state.heard) / 1000, every = state.status?.every_s;
  const overdue = every !== null && every !== undefined && state.heard > 0 && age > 3 * every + 3;
  const why = !state.online ? "no connection to the daemon" : overdue ? "the next one is overdue" : "";
  $("freshness").textContent = [...(state.heard ? [`#${state.last}`, ago(age)] : []), ...(why ? [why] : [])].join(" · ");
  document.querySelector(".live").classList.toggle("stale", Boolean(why));
}, 500);

// ---- state ---------------------------------------------------------------------------------------------------------
function showAlarms() {
  const alarms = state.status ? state.status.alarms : [];
  const faults = [...state.faults.values()].map((message) => ({ message, since: null }));
  const all = [...(state.online ? alarms : [{ message: "No connection to the daemon; trying again.", since: null }]), ...faults];
  const shown = JSON.stringify(all);
  if ($("alarms").dataset.shown === shown) return;  // announced once, not at every reading, to screen readers
  $("alarms").dataset.shown = shown;
  $("alarms").replaceChildren(...all.map((alarm) => {
    const row = document.createElement("div");
    row.className = "alarm";
    row.textContent = withSuperscripts(alarm.message);
    if (alarm.since) { const t = document.createElement("time"); t.textContent = `since ${new Date(alarm.since).toLocaleTimeString([], { hour12: false })}`; row.append(t); }
    return row;
  }));
}
function showStatus(status) {
  state.status = status;
  showAlarms();
  part("the lights", showLights);
  part("the devices", showDevices);
  part("the patches", showPatches);
  part("the exposure", showSettings);
  part("the calibration", showCalibration);
  part("the picture", placePatch);
  refreshEvents();
  if (Object.keys(status.patches || {}).sort().join() !== [...panels.keys()].sort().join()) freshTrends(true);
  if (state.curve === undefined) loadCurve();
}
function showDevices() {
  const { instrument, devices, software, clock_jump } = state.status;
  $("who").textContent = `${instrument.vendor} ${instrument.model} · ${instrument.serial}${instrument.serial_also && ` (${instrument.serial_also})`}`;
  $("software").textContent = software;
  $("devices").replaceChildren(...Object.entries(devices).map(([name, device]) => deviceRow(name, device)));
  $("clock-note").textContent = clock_jump ? `${clock_jump.message.split(",")[0]} · ` : "";
}
function showSettings() {
  const { settings, every_s } = state.status;
  const fields = [["auto", "checked", settings.auto_exposure], ["continuous", "checked", every_s !== null], ["period", "value", every_s ?? $("period").value],
    ["exposure", "value", +(settings.exposure_s * 1000).toPrecision(6)], ["gain", "value", settings.gain_db], ["wavelength", "value", settings.wavelength_nm ?? ""]];
  for (const [id, property, value] of fields) if (document.activeElement !== $(id)) $(id)[property] = value;
  $("exposure").disabled = settings.auto_exposure;
}
function showCalibration() {
  const { calibration } = state.status, made = calibration.created ? calibration.created.slice(0, 10) : "";
  $("calibration").textContent = calibration.source ? [calibration.source, made].filter(Boolean).join(" · ") : "no calibration: values are relative";
  $("calibration").title = (calibration.assumptions || []).map((a) => `assumed: ${a}`).join("\n");
}
function deviceRow(name, device) {
  const row = document.createElement("div"), b = document.createElement("b"), s = document.createElement("span"), facts = document.createElement("span");
  row.className = "device"; b.textContent = name;
  s.textContent = device.state; s.className = `state${device.state === "ready" ? "" : " bad"}`;
  const counts = Object.entries(device.counters).filter(([, n]) => n).map(([k, n]) => `${k.replace(/_/g, " ")} ${n}`);
  facts.className = "quiet";
  facts.textContent = [device.temperature_C === null ? "" : `${device.temperature_C.toFixed(1)} °C`, device.losses ? `lost ${device.losses}×` : "", ...counts].filter(Boolean).join(" · ");
  facts.title = facts.textContent;
  row.append(b, facts, s);
  return row;
}
// A level is shown only while the daemon is there and the box confirms it; else it is unknown, and "Lights off" lit.
function showLights() {
  const levels = state.status?.light || {}, limits = state.status?.light_limits || {}, box = $("lights"), names = Object.keys(levels);
  const percent = (level) => `${+(100 * level).toPrecision(level < 0.1 ? 2 : 3)} %`;
  const shown = new Map(names.map((name) => [name, state.online ? levels[name] : null]));
  $("lights-off").classList.toggle("lit", [...shown.values()].some((level) => level !== 0));
  if ([...box.children].map((row) => row.dataset.channel).join("\n") !== names.join("\n")) box.replaceChildren(...names.map((name) => lightRow(name, percent)));
  [...shown].forEach(([name, level], i) => {
    const [, slider, output] = box.children[i].children, most = own(limits, name) ?? 1;
    slider.max = Math.max(most, level || 0); slider.step = most / 200 || "any";
    slider.title = `at most ${percent(most)}: what the box and the account of the eye's exposure accept now`;
    slider.disabled = level === null;
    if (document.activeElement === slider && slider.matches(":active")) return;
    slider.value = level ?? 0;
    output.textContent = level === null ? "unknown" : percent(level);
  });
}
function lightRow(name, percent) {
  const row = document.createElement("label"), slider = document.createElement("input"), text = document.createElement("span"), output = document.createElement("output");
  row.className = "light"; row.dataset.channel = name; text.textContent = name.replace("_", " "); slider.type = "range"; slider.min = 0; slider.name = name;
  slider.addEventListener("input", () => { output.textContent = percent(+slider.value); });
  slider.addEventListener("change", () => send("/light", { channel: name, level: +slider.value }));
  row.append(text, slider, output);
  return row;
}
async function loadCurve() {
  state.curve = null;
  try { state.curve = await (await ask("/response")).json(); } catch { /* none in use */ }
  part("the response", showResponse);
}
const showResponse = () => drawResponse($("response"), state.curve || null);

// ---- picture and patch ---------------------------------------------------------------------------------------------
let waiting = false;
async function refreshPicture() {
  if (state.busy || document.hidden) { waiting = true; return; }
  state.busy = true; waiting = false;
  try {
    const map = root.dataset.theme === "red" ? "red" : "inferno";
    const width = Math.min(1400, Math.round($("stage").clientWidth * Math.min(2, window.devicePixelRatio || 1))) || 808;
    const reply = await ask(`/frame.png?bar=false&map=${map}&width=${Math.max(64, width)}`);
    const old = $("picture").src, [w, h] = reply.headers.get("Radiometer-Frame").split(",").map(Number);
    $("picture").src = URL.createObjectURL(await reply.blob());
    if (old) URL.revokeObjectURL(old);
    $("picture").dataset.map = map;
    state.frame = { w, h };
    $("nothing").hidden = true;
    showLegend(reply.headers, map);
    placePatch();
    showPatches();
  } catch { /* none yet */ }
  setTimeout(() => { state.busy = false; if (waiting) refreshPicture(); }, 700);
}
function showLegend(headers, map) {
  const unit = unitText(headers.get("Radiometer-Unit"));
  $("legend").hidden = false;
  drawRamp($("ramp"), map);
  $("ticks").replaceChildren(...headers.get("Radiometer-Ticks").split(",").map((label, place, all) => {
    const t = document.createElement("span");
    t.textContent = `${label.replace(/e([+-]\d+)/, (_, n) => `·10${superscript(+n)}`)}${place === all.length - 1 ? ` ${unit}` : ""}`;
    return t;
  }));
}
const current = () => {
  const { w, h } = state.frame, patch = state.drag?.patch || state.status?.settings.patch || state.latest.get("main")?.patch;
  return patch || { x: Math.round(w * 0.45), y: Math.round(h * 0.45), width: Math.max(1, Math.floor(w / 10)), height: Math.max(1, Math.floor(h / 10)) };
};
function placePatch() {
  if (!state.frame || !state.status) return;
  const { w, h } = state.frame, p = current(), style = $("patch").style;
  $("patch").hidden = false;
  style.left = `${(100 * p.x) / w}%`; style.top = `${(100 * p.y) / h}%`; style.width = `${(100 * p.width) / w}%`; style.height = `${(100 * p.height) / h}%`;
  const text = `patch ${p.x}, ${p.y} · ${p.width} × ${p.height} pixels`;
  $("place").textContent = `${text} of ${w} × ${h}`;
  $("patch").setAttribute("aria-valuetext", text);
}
const clamp = (v, low, high) => Math.min(Math.max(v, low), high);
function moved(from, dx, dy, resizing) {
  const { w, h } = state.frame;
  if (resizing) return { ...from, width: clamp(Math.round(from.width + dx), 2, w - from.x), height: clamp(Math.round(from.height + dy), 2, h - from.y) };
  return { ...from, x: clamp(Math.round(from.x + dx), 0, w - from.width), y: clamp(Math.round(from.y + dy), 0, h - from.height) };
}
async function commitPatch(patch) {
  const status = await send("/settings", { patch });
  state.drag = null;
  placePatch();
  if (status && status.every_s === null) await measureNow();
}
$("patch").addEventListener("pointerdown", (event) => {
  if (!state.frame) return;
  event.preventDefault();
  $("patch").focus({ preventScroll: true });
  $("patch").setPointerCapture(event.pointerId);
  state.drag = { from: current(), patch: current(), x: event.clientX, y: event.clientY, resizing: event.target.id === "corner" };
});
$("patch").addEventListener("pointermove", (event) => {
  if (!state.drag) return;
  const box = $("picture").getBoundingClientRect(), { from, x, y, resizing } = state.drag;
  state.drag.patch = moved(from, ((event.clientX - x) * state.frame.w) / box.width, ((event.clientY - y) * state.frame.h) / box.height, resizing);
  placePatch();
});
$("patch").addEventListener("pointerup", () => { if (state.drag) commitPatch(state.drag.patch); });
$("patch").addEventListener("pointercancel", () => { state.drag = null; placePatch(); });
$("patch").addEventListener("keydown", (event) => {
  const step = event.shiftKey ? 20 : 4, by = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
  if (!by || !state.frame) return;
  event.preventDefault();
  commitPatch(moved(current(), by[0], by[1], event.altKey));
});

// ---- controls ------------------------------------------------------------------------------------------------------
async function measureNow() {
  $("measure").disabled = true;
  await send("/measure", {});
  $("measure").disabled = false;
}
$("measure").addEventListener("click", measureNow);
const periodic = () => send("/settings", { every_s: $("continuous").checked ? Math.max(0, +$("period").value || 0) : null });
$("continuous").addEventListener("change", periodic);
$("period").addEventListener("change", periodic);
$("auto").addEventListener("change", () => send("/settings", { auto_exposure: $("auto").checked }));
$("exposure").addEventListener("change", () => send("/settings", { exposure_s: +$("exposure").value / 1000, auto_exposure: false }));
$("gain").addEventListener("change", () => send("/settings", { gain_db: +$("gain").value }));
$("wavelength").addEventListener("change", () => send("/settings", { wavelength_nm: $("wavelength").value === "" ? null : +$("wavelength").value }));

// A plain link cannot send the token, so what it points to is fetched and handed over as a file.
document.querySelectorAll("footer a, #export").forEach((link) => link.addEventListener("click", async (event) => {
  if (!sessionStorage.getItem("token")) return;
  event.preventDefault();
  const made = document.createElement("a");
  made.href = URL.createObjectURL(await (await ask(link.getAttribute("href"))).blob());
  made.download = link.download || link.textContent;
  made.click();
  setTimeout(() => URL.revokeObjectURL(made.href), 10000);
}));

function setTheme(theme) {
  root.dataset.theme = theme;
  localStorage.setItem("theme", theme);
  document.querySelectorAll(".themes button").forEach((b) => b.setAttribute("aria-pressed", b.dataset.theme === theme));
  document.querySelector('meta[name="theme-color"]').content = getComputedStyle(root).getPropertyValue("--ground").trim();
  for (const panel of panels.values()) panel.plot.redraw();
  part("the response", showResponse);
  if (state.frame) refreshPicture();
}
document.querySelectorAll(".themes button").forEach((b) => b.addEventListener("click", () => setTheme(b.dataset.theme)));
new ResizeObserver(() => part("the response", showResponse)).observe($("response").parentElement);
document.addEventListener("visibilitychange", () => { if (!document.hidden && waiting) refreshPicture(); });

// One column, or three: the cards lie in the order in which they are seen, so that the tab key follows it.
const narrow = matchMedia("(max-width: 1079px)"), columns = [...document.querySelectorAll(".column")].map((column) => [column, [...column.children]]);
function arrange() {
  if (narrow.matches) document.querySelector("main").append(...["live", "trend", "patches", "scene", "devices", "events", "settings", "response"].map((name) => document.querySelector(`.card.${name}`)));
  else columns.forEach(([column, cards]) => column.append(...cards));
}
narrow.addEventListener("change", arrange);
arrange();

const remembered = localStorage.getItem("theme");
setTheme(remembered || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
setSpan(+localStorage.getItem("span") || 3600);
showEvents();
try {
  state.events = (await (await ask(`/events?limit=${EVENTS_KEPT}`)).json()).reverse();
  showEvents();
  const history = await (await ask("/readings?limit=1")).json();
  history.forEach((reading) => { note(reading); showReading(reading); });
} catch { /* the stream reports it */ }
follow();
