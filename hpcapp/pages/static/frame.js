// From places of the scene to coordinates of its file, with the digits that the page can tell.

export class Frame {
  /** The page holds a place to a 65535th of the longest side of `box`. */
  constructor(origin, box) {
    this.origin = origin;
    const low = box.min.toArray(), high = box.max.toArray();
    const step = (Math.max(...high.map((end, k) => end - low[k])) || 1) / 65535;
    this.decimals = Math.min(100, Math.max(0, Math.ceil(-Math.log10(step))));
  }

  /** A coordinate in the file, as short as it can be. */
  world(number, axis) {
    return Number((number + this.origin[axis]).toFixed(this.decimals));
  }

  /** The place of the scene that such a coordinate is. */
  local(number, axis) { return this.world(number, axis) - this.origin[axis]; }
}
