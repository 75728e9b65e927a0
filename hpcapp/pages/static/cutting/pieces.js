// The largest pieces of a mesh are kept, as many as a number says.

const NEXT = 0.0005; // of the area: less is said as "less than"

export class PiecesCut {
  constructor({ kept, onChange }, pieces, input) {
    Object.assign(this, { kept, onChange, pieces, input });
    input.max = pieces.shares.length;
    input.value = pieces.suggested;
    input.addEventListener('input', () => this.#change());
  }

  start() { this.#change(); }

  stop() {}

  /** How many are kept; null while no number stands there. */
  get most() {
    const most = Number(this.input.value);
    return Number.isInteger(most) && most >= 1 && most <= this.pieces.shares.length ? most : null;
  }

  get option() { return this.most && `--pieces ${this.most}`; }

  get said() {
    if (!this.most) return `Give a number from 1 to ${this.pieces.shares.length}.`;
    const gone = 1 - this.pieces.shares[this.most - 1];
    const dropped = this.pieces.count - this.most;
    if (!dropped) return 'All pieces stay.';
    const share = gone < NEXT ? 'less than 0.1' : (100 * gone).toFixed(1);
    return `${dropped.toLocaleString('en')} ${dropped === 1 ? 'piece goes' : 'pieces go'}, `
      + `${share} % of the area.`;
  }

  #change() {
    if (this.most) this.kept.pieces(this.most); else this.kept.all();
    this.onChange();
  }
}
