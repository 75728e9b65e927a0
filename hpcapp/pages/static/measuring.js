// Two places, picked with the pointer, and how far they are from each other.
import { sayNumber } from 'hpcapp/numbers.js';

const STILL = 4; // pixels: a press that moves farther turns the view

export class Measuring {
  /** A button switches it on and off; `said` is where the result stands. */
  constructor(viewer, button, said, unit) {
    Object.assign(this, { viewer, button, said, unit, places: [] });
    const canvas = viewer.renderer.domElement;
    let pressed = null;
    button.addEventListener('click', () => this.turn(!this.isOn));
    canvas.addEventListener('pointerdown', (event) => { pressed = event; });
    canvas.addEventListener('pointerup', (event) => {
      const moved = Math.hypot(event.clientX - pressed?.clientX, event.clientY - pressed?.clientY);
      if (this.isOn && moved < STILL) this.take(viewer.pick(event.clientX, event.clientY));
    });
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
      this.said.textContent = 'Pick another one.';
      this.viewer.setLine(this.places);
      return;
    }
    const steps = to.map((part, k) => part - from[k]);
    const length = sayNumber(Math.hypot(...steps), this.unit);
    this.said.textContent = `${length} (${['x', 'y', 'z'].map((axis, k) => (
      `${axis} ${sayNumber(steps[k])}`)).join(', ')})`;
    this.viewer.setLine(this.places, length);
  }
}
