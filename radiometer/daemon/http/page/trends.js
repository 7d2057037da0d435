// The course of each patch over time: one panel of uPlot per patch, one time axis for all of them.
import uPlot from "/uplot.js";
import { css, tickLabel, timeText, unitText } from "/text.js";

const DAY = 86400;
const sync = uPlot.sync("time");

function axisTimes(u, splits) {
  const span = u.scales.x.max - u.scales.x.min, step = splits.length > 1 ? splits[1] - splits[0] : span;
  return splits.map((at) => {
    const d = new Date(at * 1000), clock = d.toLocaleTimeString([], { hour12: false, hour: "2-digit", minute: "2-digit", ...(step < 60 ? { second: "2-digit" } : {}) });
    const day = d.toLocaleDateString([], { day: "numeric", month: "short" });
    if (step >= DAY) return day;
    return d.getHours() === 0 && d.getMinutes() === 0 && span > DAY / 2 ? day : clock;
  });
}

// Between ticks: a step of 2.5, which is uPlot's own as well, has a digit more than its label.
const STEPS = Array.from({ length: 40 }, (_, i) => i - 24).flatMap((power) => [1, 2, 5].map((m) => +`${m}e${power}`));

const LIMIT_ROOM = 10;  // ranges of the readings; farther away a limit would leave no height for them

/** One patch: its panel, its plot, and the columns it shows. */
export class TrendPanel {
  constructor(place, name, hover) {
    this.name = name; this.hover = hover; this.columns = null; this.limits = {}; this.limitsSince = 0; this.breached = ""; this.events = []; this.window = [0, 1];
    this.root = document.createElement("figure");
    this.root.className = "panel";
    this.root.dataset.patch = name;
    this.caption = document.createElement("figcaption");
    this.title = document.createElement("b"); this.readout = document.createElement("span"); this.readout.className = "quiet";
    this.title.textContent = name === "main" ? "patch" : name;
    this.unit = document.createElement("span"); this.unit.className = "unit"; this.title.append(this.unit);
    this.newest = document.createElement("span"); this.newest.className = "newest";
    this.caption.append(this.title, this.newest, this.readout);
    this.frame = document.createElement("div");
    this.frame.className = "plot";
    this.empty = document.createElement("p");
    this.empty.className = "quiet empty";
    this.root.append(this.caption, this.frame);
    this.frame.append(this.empty);
    place.append(this.root);
    this.make();
  }
  make() {
    this.plot?.destroy();
    const grid = { stroke: () => css("--line"), width: 1 }, axis = { stroke: () => css("--quiet"), font: "12px system-ui, sans-serif", grid, ticks: { ...grid, size: 5 } };
    const hidden = { stroke: "transparent", points: { show: false } };
    this.plot = new uPlot({
      width: Math.max(80, this.frame.clientWidth), height: Math.max(60, this.frame.clientHeight), legend: { show: false }, padding: [6, 20, 0, 0],
      scales: { x: { time: true, range: () => this.window }, y: { range: (u, low, high) => this.range(low, high) } },
      axes: [{ ...axis, values: axisTimes, space: 74, size: 26 }, { ...axis, size: 66, space: 30, incrs: STEPS, values: (u, splits) => splits.map((v) => tickLabel(v, Math.abs((splits[1] ?? 1) - splits[0]) || 1)) }],
      series: [{}, { ...hidden, label: "value + U" }, { ...hidden, label: "value − U" },
        { label: "highest", stroke: () => css("--faint"), width: 1, points: { show: false } }, { label: "lowest", stroke: () => css("--faint"), width: 1, points: { show: false } },
        { label: "value", stroke: () => css("--accent"), width: 1.8, points: { show: (u, s, from, to) => to - from < 60, size: 4, fill: () => css("--accent") } }],
      bands: [{ series: [1, 2], fill: () => css("--band") }],
      cursor: { sync: { key: sync.key }, drag: { x: false, y: false }, points: { size: 7 } },
      hooks: { draw: [(u) => this.marks(u)], setCursor: [(u) => this.tell(u.cursor.idx)] },
    }, this.data(), this.frame);
    this.observer ??= new ResizeObserver(() => this.fit());
    this.observer.observe(this.frame);
  }
  fit() {
    const width = Math.max(80, this.frame.clientWidth), height = Math.max(60, this.frame.clientHeight);
    if (width !== this.plot.width || height !== this.plot.height) this.plot.setSize({ width, height });
  }
  data() {
    const c = this.columns;
    if (!c) return [[], [], [], [], [], []];
    const with_ = (sign) => c.value.map((v, i) => (v === null ? null : v + sign * c.U[i]));
    return [c.time, with_(1), with_(-1), c.high, c.low, c.value];
  }
  range(low, high) {
    const shown = [low, high].filter((v) => v !== null && Number.isFinite(v));
    if (!shown.length) return [0, 1];
    let [bottom, top] = [Math.min(...shown), Math.max(...shown)];
    const room = LIMIT_ROOM * Math.max(top - bottom, Math.abs(top) * 0.02), [least, most] = [bottom - room, top + room];
    for (const side of ["low", "high"]) {  // a limit that is near, or broken, belongs into the picture
      const limit = this.limits[side];
      if (limit != null && (this.breached === side || (limit > least && limit < most))) { bottom = Math.min(bottom, limit); top = Math.max(top, limit); }
    }
    const pad = Math.max((top - bottom) * 0.1, Math.abs(top) * 1e-4, 1e-12);
    return [bottom - pad, top + pad];
  }
  marks(u) {
    const pen = u.ctx, { left, top, width, height } = u.bbox, ratio = devicePixelRatio || 1;
    pen.save();
    pen.beginPath(); pen.rect(left, top, width, height); pen.clip();
    pen.lineWidth = 1.4 * ratio; pen.strokeStyle = css("--bad"); pen.setLineDash([6 * ratio, 4 * ratio]);
    for (const limit of [this.limits.low, this.limits.high]) {
      if (limit == null) continue;
      const y = u.valToPos(limit, "y", true);
      pen.beginPath(); pen.moveTo(Math.max(left, u.valToPos(this.limitsSince, "x", true)), y); pen.lineTo(left + width, y); pen.stroke();
    }
    pen.setLineDash([2 * ratio, 3 * ratio]); pen.lineWidth = ratio;
    const drawn = new Set(), crowded = this.events.length > width / (24 * ratio);  // lines would hide the curve
    for (const event of this.events) {  // where many fall together, one line of each kind is enough
      const x = u.valToPos(event.at, "x", true), bad = event.kind === "alarm" || event.kind === "changed", place = `${event.kind} ${Math.round(x / (4 * ratio))}`;
      if (drawn.has(place)) continue;
      drawn.add(place);
      pen.strokeStyle = pen.fillStyle = css(bad ? "--bad" : event.kind === "remark" ? "--ink" : "--quiet");
      if (!crowded || event.kind === "remark") { pen.beginPath(); pen.moveTo(x, top); pen.lineTo(x, top + height); pen.stroke(); }
      pen.beginPath(); pen.moveTo(x - 4 * ratio, top); pen.lineTo(x + 4 * ratio, top); pen.lineTo(x, top + 7 * ratio); pen.fill();
    }
    pen.restore();
  }
  tell(index) {
    const c = this.columns;
    if (!c) return;
    const shown = index != null && c.value[index] !== null ? index : null, left = this.plot.cursor.left;
    const near = (left < 0 ? [] : this.events.filter((e) => Math.abs(this.plot.valToPos(e.at, "x") - left) < 6)).sort((a, b) => b.at - a.at);
    const event = near.find((e) => e.kind === "remark") || near.find((e) => e.kind === "alarm") || near[0];
    const more = near.length > 1 ? ` (and ${near.length - 1} more)` : "";  // what people wrote comes first, the newest of it
    this.readout.textContent = event ? `${timeText(event.at, 7201)}   ${event.kind}: ${event.message}${more}` : this.hover(this, shown);
  }
  /** Say the newest reading, where the list of patches may not have room for all. */
  now(text, breached) {
    this.newest.textContent = text;
    if (this.breached !== breached) { this.breached = breached; this.plot.setData(this.data()); }
    this.root.classList.toggle("bad", Boolean(breached));
  }
  show(columns, window, limits, limitsSince, events) {
    Object.assign(this, { columns, window, limitsSince, limits: limits && ["", columns?.unit].includes(limits.unit ?? "") ? limits : {}, events: events || [] });
    this.unit.textContent = columns?.unit ? unitText(columns.unit) : "";
    this.empty.textContent = columns?.value.some((v) => v !== null) ? "" : "no readings in this time";
    this.plot.setData(this.data());
    this.fit();
    this.tell(this.plot.cursor.idx);
  }
  remove() { this.observer.disconnect(); this.plot.destroy(); this.root.remove(); }
}
