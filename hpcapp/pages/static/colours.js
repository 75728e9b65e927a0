// From the numbers of vertices to colours, and the legends that say which is which.

const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141],
  [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];
const NONE = [150, 150, 150];

/** The colour of a share from 0 to 1. */
export function viridis(share) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const first = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return VIRIDIS[first].map((part, k) => part + (at - first) * (VIRIDIS[first + 1][k] - part));
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

/** Return what `Viewer.colour` asks for. */
export function shadeField(viewer, mesh, field, values) {
  const put = (rgb, [r, g, b]) => { rgb[0] = r; rgb[1] = g; rgb[2] = b; };
  switch (field?.kind) {
    case 'rgb':
      return (i, rgb) => put(rgb, values.subarray(3 * i, 3 * i + 3));
    case 'normals':
      return (i, rgb) => {
        const [x, y, z] = viewer.normal(mesh, i);
        put(rgb, [127.5 + x, 127.5 + y, 127.5 + z]);
      };
    case 'label': {
      const table = field.labels.map((_, number) => labelColour(number));
      return (i, rgb) => put(rgb, table[values[i]] ?? NONE);
    }
    case 'scale': {
      const table = Array.from({ length: 256 }, (_, n) => (n === 255 ? NONE : viridis(n / 254)));
      return (i, rgb) => put(rgb, table[values[i]]);
    }
    default:
      return null;
  }
}

const number = (value) => Number(value.toPrecision(3)).toString();

/** Return the elements that explain a field's colours. */
export function legend(field) {
  const text = (words) => Object.assign(document.createElement('span'), { textContent: words });
  const swatch = (colour) => {
    const box = document.createElement('i');
    box.style.background = colour;
    return box;
  };
  const css = (rgb) => `rgb(${rgb.map(Math.round)})`;
  if (field?.kind === 'scale') {
    const bar = document.createElement('b');
    const stops = VIRIDIS.map(css).join(',');
    bar.style.background = `linear-gradient(to right, ${stops})`;
    return [text(number(field.low)), bar, text(`${number(field.high)} ${field.unit}`),
      ...(field.lacks ? [swatch(css(NONE)), text('none')] : [])];
  }
  if (field?.kind === 'label') {
    return field.labels.slice(0, 12).flatMap((label, n) => [swatch(css(labelColour(n))),
      text(label)]).concat(field.labels.length > 12 ? [text('…')] : []);
  }
  if (field?.kind === 'normals') {
    return [swatch('rgb(255,128,128)'), text('+x'), swatch('rgb(128,255,128)'), text('+y'),
      swatch('rgb(128,128,255)'), text('+z')];
  }
  return [];
}
