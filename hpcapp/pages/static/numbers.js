// Numbers as people read them; hpcapp/wording.py does the same for what is written beforehand.

/** A measured number with three digits, and its unit. */
export function sayNumber(number, unit = '') {
  const behind = unit ? ` ${unit}` : '';
  if (number === 0 || !Number.isFinite(number)) return `${number}${behind}`;
  const size = Math.abs(number);
  if (size < 1e-4 || size >= 1e7) return `${number.toExponential(2)}${behind}`;
  const rounded = Number(number.toPrecision(3));
  const decimals = Math.max(0, 2 - Math.floor(Math.log10(Math.abs(rounded)) + 1e-12));
  return rounded.toLocaleString('en', { minimumFractionDigits: decimals,
    maximumFractionDigits: decimals }) + behind;
}

/** Round numbers between two: multiples of 1, 2 or 5 times a power of ten; `most` steps at most. */
export function roundTicks(low, high, most = 4) {
  const span = high - low;
  if (!(span > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(span / most));
  const step = [1, 2, 5, 10, 20].map((factor) => factor * power)
    .find((one) => span <= one * most * (1 + 1e-9));
  const ticks = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * span; n++) ticks.push(n * step);
  return ticks;
}

/** A tick as short as it can be. */
export function sayTick(tick) {
  return tick === 0 ? '0' : Number(tick.toPrecision(6)).toLocaleString('en',
    { maximumSignificantDigits: 6 });
}
