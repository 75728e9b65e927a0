// From the numbers of vertices to colours, and the legends that say which is which.
import { roundTicks, sayNumber, sayTick } from 'hpcapp/numbers.js';

const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
  [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];
const SIDES = [[33, 86, 160], [84, 148, 196], [168, 205, 226], [240, 240, 240], [250, 199, 172],
  [226, 120, 92], [166, 24, 43]]; // inside, on the surface, outside
const NONE = [150, 150, 150];
const GUESSED = [205, 40, 170], BLEND = 0.8; // the tint of guesswork, and how strong it is
const SHADES = 256, BARS = 48, MOST = 65534; // the level 65535 means: no number
const DECADES = 3; // of a scale's end that the slider goes through

/** The colour of a share from 0 to 1. */
function shade(stops, share) {
  const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const first = Math.min(Math.floor(at), stops.length - 2);
  return stops[first].map((part, k) => part + (at - first) * (stops[first + 1][k] - part));
}

const stopsOf = (field) => (field.signed ? SIDES : VIRIDIS);

/** The farthest number that a scale can end at. */
const limitOf = (field) => (field.signed ? Math.max(-field.from, field.to) : field.to);

/** Where the numbers of a scale begin that ends at `end`. */
const startOf = (field, end) => (field.signed ? -end : Math.min(field.low, end));

/** The end of a scale by a slider's place from 0 to 1, and the other way. */
export function endAt(field, place) {
  const start = field.signed ? 0 : field.low;
  return start + (limitOf(field) - start) * 10 ** (DECADES * (place - 1));
}

export function placeOf(field, end) {
  const start = field.signed ? 0 : field.low, span = limitOf(field) - start;
  return span > 0 && end > start ? Math.max(0, 1 + Math.log10((end - start) / span) / DECADES) : 1;
}

/** The number that a level of a field stands for; NaN where there is none. */
const valueOf = (field, level) => (level > MOST ? NaN
  : field.from + (field.to - field.from) * level / MOST);

/** Tell which vertices are guesswork: bytes of 0 and 1. */
export function markGuesses(field, levels, beyond) {
  return Uint8Array.from(levels, (level) => (valueOf(field, level) > beyond ? 1 : 0));
}

/** Return what `Viewer.colour` asks for: what it was, and tinted where the surface is guesswork. */
export function tint(shading, plain, guesses) {
  return (i, rgb) => {
    if (shading) shading(i, rgb); else [rgb[0], rgb[1], rgb[2]] = plain;
    if (guesses[i]) for (let k = 0; k < 3; k++) rgb[k] += BLEND * (GUESSED[k] - rgb[k]);
  };
}

/** Colours of labels: neighbouring numbers differ. */
export function labelColour(number) {
  const hue = (number * 0.61803398875 + 0.08) % 1, light = number % 2 ? 0.62 : 0.5;
  const part = (n) => {
    const k = (n + 12 * hue) % 12;
    return 255 * (light - 0.42 * Math.min(light, 1 - light)
      * Math.max(-1, Math.min(k - 3, 9 - k, 1)));
  };
  return [part(0), part(8), part(4)];
}

/** Return what `Viewer.colour` asks for; a scale ends at `end`. */
export function shadeField(viewer, drawn, field, values, end) {
  const put = (rgb, [r, g, b]) => { rgb[0] = r; rgb[1] = g; rgb[2] = b; };
  switch (field?.kind) {
    case 'rgb':
      return (i, rgb) => put(rgb, values.subarray(3 * i, 3 * i + 3));
    case 'normals':
      return (i, rgb) => {
        if (values) return put(rgb, values.subarray(3 * i, 3 * i + 3));
        const [x, y, z] = viewer.normal(drawn, i);
        return put(rgb, [127.5 + x, 127.5 + y, 127.5 + z]);
      };
    case 'label': {
      const table = field.labels.map((_, number) => labelColour(number));
      return (i, rgb) => put(rgb, table[values[i]] ?? NONE);
    }
    case 'scale': {
      const table = Array.from({ length: SHADES }, (_, n) => shade(stopsOf(field), n / (SHADES - 1)));
      const start = startOf(field, end), span = end - start || 1;
      return (i, rgb) => {
        const share = (valueOf(field, values[i]) - start) / span;
        put(rgb, Number.isNaN(share) ? NONE
          : table[Math.round((SHADES - 1) * Math.min(Math.max(share, 0), 1))]);
      };
    }
    default:
      return null;
  }
}

const css = (rgb) => `rgb(${rgb.map(Math.round)})`;

function make(tag, className, words = '') {
  const element = document.createElement(tag);
  element.className = className;
  element.textContent = words;
  return element;
}

function swatch(colour, words) {
  const label = make('span', 'swatch', words), box = document.createElement('i');
  box.style.background = colour;
  label.prepend(box);
  return label;
}

/** Bars of how many vertices have which number, over the colours and round ticks. */
function scale(field, levels, end) {
  const start = startOf(field, end), span = end - start || 1, stops = stopsOf(field);
  const counts = new Array(BARS).fill(0);
  for (const level of levels ?? []) {
    const share = (valueOf(field, level) - start) / span;
    if (!Number.isNaN(share)) {
      counts[Math.min(BARS - 1, Math.max(0, Math.floor(BARS * share)))] += 1;
    }
  }
  const most = Math.max(...counts, 1), drawn = make('div', 'scale');
  const bars = make('div', 'bars');
  bars.append(...counts.map((count, n) => {
    const bar = document.createElement('u');
    bar.style.height = `${100 * Math.sqrt(count / most)}%`; // few are to be seen beside many
    bar.style.background = css(shade(stops, (n + 0.5) / BARS));
    bar.title = `${count.toLocaleString('en')} of them, ${sayNumber(start + span * n / BARS)} to `
      + sayNumber(start + span * (n + 1) / BARS, field.unit);
    return bar;
  }));
  const colours = make('b', '');
  colours.style.background = `linear-gradient(to right, ${stops.map(css).join(',')})`;
  const ticks = make('div', 'ticks');
  ticks.append(...roundTicks(start, end).map((tick) => {
    const mark = make('span', '', sayTick(tick));
    mark.style.left = `${100 * (tick - start) / span}%`;
    return mark;
  }));
  drawn.append(bars, colours, ticks);
  return drawn;
}

/** Return the elements that explain a field's colours. */
export function legend(field, levels, end) {
  if (field?.kind === 'scale') {
    const cut = end < limitOf(field) * (1 - 1e-6)
      ? `; ends at ${sayNumber(end)}, the largest is ${sayNumber(limitOf(field))}` : '';
    return [scale(field, levels, end),
      make('span', '', (field.signed ? `blue: ${field.sides[0]}, red: ${field.sides[1]}; ` : '')
        + (field.unit ? `in ${field.unit}` : "in the file's units") + cut),
      ...(field.lacks ? [swatch(css(NONE), 'none')] : [])];
  }
  if (field?.kind === 'label') {
    return field.labels.slice(0, 12).map((label, n) => swatch(css(labelColour(n)), label))
      .concat(field.labels.length > 12 ? [make('span', '', '…')] : []);
  }
  if (field?.kind === 'normals') {
    return [swatch('rgb(255,128,128)', '+x'), swatch('rgb(128,255,128)', '+y'),
      swatch('rgb(128,128,255)', '+z')];
  }
  return [];
}

/** Return what explains the tint of guesswork. */
export const explainTint = (words) => swatch(css(GUESSED), words);
