// Two places, picked with the pointer, and how far they are from each other.
import { sayNumber } from 'hpcapp/numbers.js';
import { onTap } from 'hpcapp/taps.js';

export class Measuring {
  /**
   * A button switches it on and off; `said` is where the result stands, in the unit of x and y, of
   * which a unit of z is `heightScale`; coordinates are those of a frame, if there is one.
   */
  constructor(viewer, button, said, frame, { unit, heightScale }) {
    Object.assign(this, { viewer, button, said, frame, unit, heightScale, places: [] });
    button.addEventListener('click', () => this.turn(!this.isOn));
    onTap(viewer.renderer.domElement, (x, y) => { if (this.isOn) this.take(viewer.pick(x, y)); });
    this.turn(false);
  }

  turn(isOn) {
    this.isOn = isOn;
    this.button.setAttribute('aria-pressed', isOn);
    this.viewer.renderer.domElement.style.cursor = isOn ? 'crosshair' : '';
    this.places = [];
    this.viewer.setLine([]);
    this.said.textContent = isOn ? 'Pick a place.' : '';
  }

  /** Take a place that was picked; the third one begins anew. */
  take(place) {
    if (!place) return;
    this.places = this.places.length === 2 ? [place] : [...this.places, place];
    const [from, to] = this.places;
    if (!to) {
      const at = this.frame && from.map((part, axis) => this.frame.world(part, axis)).join(', ');
      this.said.textContent = `${at ? `${at}. ` : ''}Pick another one.`;
      this.viewer.setLine(this.places);
      return;
    }
    const steps = to.map((part, k) => (part - from[k]) * (k === 2 ? this.heightScale : 1));
    const length = sayNumber(Math.hypot(...steps), this.unit);
    this.said.textContent = `${length} (${['dx', 'dy', 'dz'].map((axis, k) => (
      `${axis} ${sayNumber(steps[k], this.unit)}`)).join(', ')})`;
    this.viewer.setLine(this.places, length);
  }
}
