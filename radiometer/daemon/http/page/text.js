// Words and numbers as the page writes them, and the colours of its theme.
export const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const POWERS = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
export const superscript = (n) => String(n).replace(/./g, (c) => POWERS[c]);
// A tick of an axis: as many digits as its steps need, very large and very small ones with a power of ten.
export const tickLabel = (value, step) => {
  const digits = (unit) => Math.min(8, Math.max(0, -Math.floor(Math.log10(step / unit) + 1e-9)));
  if (value === 0 || (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e5)) return value.toFixed(digits(1));
  const exponent = Math.floor(Math.log10(Math.abs(value)) + 1e-9);
  return `${(value / 10 ** exponent).toFixed(digits(10 ** exponent))}·10${superscript(exponent)}`;
};
export const unitText = (unit) => unit.replace(/([a-zA-Z])(-?\d+)/g, (_, letter, power) => letter + superscript(power)).replaceAll(" ", "·");
export const timeText = (at, span) => new Date(at * 1000).toLocaleString([], {
  hour12: false, hour: "2-digit", minute: "2-digit", ...(span <= 7200 ? { second: "2-digit" } : {}), ...(span > 7200 ? { day: "numeric", month: "short" } : {}),
});
// Names come from people: one such as "constructor" must not find what every object inherits.
export const own = (mapping, name) => (mapping && Object.hasOwn(mapping, name) ? mapping[name] : undefined);
