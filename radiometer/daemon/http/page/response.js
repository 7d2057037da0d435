// The response curve and the ramp of the false colours, on a canvas.

import { css, tickLabel } from "/text.js";

export function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const width = Math.max(60, box.width), height = Math.max(40, box.height);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "11.5px system-ui, sans-serif";
  return { pen, width, height };
}

function niceTicks(low, high, count) {
  const raw = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw || 1));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw) || 10 * power;
  const ticks = [];
  for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-9; t += step) ticks.push(Math.abs(t) < step * 1e-9 ? 0 : t);
  return { ticks, step };
}

function axes(pen, box, yLow, yHigh, xTicks) {
  const { ticks, step } = niceTicks(yLow, yHigh, Math.max(3, Math.round(box.h / 42)));
  pen.strokeStyle = css("--line");
  pen.fillStyle = css("--quiet");
  pen.lineWidth = 1;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const t of ticks) {
    const y = Math.round(box.y + box.h * (1 - (t - yLow) / (yHigh - yLow))) + 0.5;
    pen.beginPath(); pen.moveTo(box.x, y); pen.lineTo(box.x + box.w, y); pen.stroke();
    pen.fillText(tickLabel(t, step), box.x - 7, y);
  }
  pen.textBaseline = "top";
  for (const [x, text, align] of xTicks) {
    pen.textAlign = align || "center";
    pen.fillText(text, x, box.y + box.h + 7);
  }
}

export function drawResponse(canvas, curve) {
  const { pen, width, height } = prepared(canvas);
  const box = { x: 46, y: 24, w: width - 56, h: height - 52 };
  if (!curve) {
    pen.fillStyle = css("--quiet"); pen.textAlign = "center";
    pen.fillText("taken as linear: no curve in use", width / 2, height / 2);
    return;
  }
  const g = curve.log_exposure, low = g[0], high = g[g.length - 1], top = curve.dn[curve.dn.length - 1];
  const x = (v) => box.x + (box.w * (v - low)) / (high - low || 1), y = (dn) => box.y + box.h * (1 - dn / top);
  const { ticks, step } = niceTicks(low, high, Math.max(2, Math.round(box.w / 70)));
  axes(pen, box, 0, top, ticks.map((t) => [x(t), tickLabel(t, step)]));
  pen.fillStyle = css("--band");
  pen.beginPath();
  g.forEach((v, i) => pen[i ? "lineTo" : "moveTo"](x(Math.max(low, v - 2 * curve.u_log_exposure[i])), y(curve.dn[i])));
  for (let i = g.length - 1; i >= 0; i--) pen.lineTo(x(Math.min(high, g[i] + 2 * curve.u_log_exposure[i])), y(curve.dn[i]));
  pen.fill();
  pen.strokeStyle = css("--accent"); pen.lineWidth = 1.8;
  pen.beginPath();
  g.forEach((v, i) => pen[i ? "lineTo" : "moveTo"](x(v), y(curve.dn[i])));
  pen.stroke();
  pen.fillStyle = css("--quiet"); pen.textAlign = "left"; pen.textBaseline = "top";
  pen.fillText(curve.linear ? "DN over ln(relative exposure), taken as linear" : curve.absolute ? "DN over ln(H / J m⁻²)" : "DN over ln(relative exposure)", box.x - 38, 2);
}

const STOPS = { inferno: ["#000004", "#1b0c41", "#4a0c6b", "#781c6d", "#a52c60", "#cf4446", "#ed6925", "#fb9b06", "#f7d13d", "#fcffa4"], red: ["#000000", "#ff0000"] };

export function drawRamp(canvas, map) {
  const { pen, width, height } = prepared(canvas), ramp = pen.createLinearGradient(0, 0, width, 0), stops = STOPS[map];
  stops.forEach((colour, i) => ramp.addColorStop(i / (stops.length - 1), colour));
  pen.fillStyle = ramp;
  pen.fillRect(0, 0, width, height);
}
