// Cutting by hand: one way at a time, and the command that does it.
import * as THREE from 'three';
import { BoxCut } from 'hpcapp/cutting/box.js';
import { Handles } from 'hpcapp/cutting/handles.js';
import { Kept } from 'hpcapp/cutting/kept.js';
import { PiecesCut } from 'hpcapp/cutting/pieces.js';
import { PolygonCut } from 'hpcapp/cutting/polygon.js';
import { save } from 'hpcapp/saving.js';
import { onTap } from 'hpcapp/taps.js';

const find = (id) => document.getElementById(id);

export class Cutting {
  /**
   * A frame gives coordinates, `look(isAbove)` shows all; `ranks` are those of the pieces of the
   * vertices of a mesh.
   */
  constructor(viewer, scene, { mesh, ranks, frame, look, measuring }) {
    const { commands, polygon, crs, pieces } = scene.cutting;
    Object.assign(this, { viewer, commands, look, cut: null });
    const shared = { viewer, frame, kept: new Kept(viewer), handles: new Handles(viewer),
      unit: scene.unit, heightScale: scene.heightScale, onChange: () => this.#say() };
    this.kept = shared.kept;
    this.ways = { box: new BoxCut(shared, scene.cutting) };
    this.ways.polygon = new PolygonCut(shared, polygon, crs);
    if (pieces) {
      mesh.geometry.setAttribute('piece', new THREE.BufferAttribute(ranks, 1));
      this.ways.pieces = new PiecesCut(shared, pieces, find('cut-most'));
    }
    find('cut').addEventListener('change', (event) => {
      measuring.turn(false);
      this.turn(event.target.value);
    });
    find('cut-into')?.addEventListener('change', () => this.#say());
    find('cut-above').addEventListener('click', () => this.look(true));
    find('cut-undo').addEventListener('click', () => this.ways.polygon.undo());
    find('cut-save').addEventListener('click', () => save(
      new Blob([this.ways.polygon.geojson], { type: 'application/geo+json' }), polygon));
    find('cut-copy').addEventListener('click', () => this.copy());
    onTap(viewer.renderer.domElement, (x, y) => {
      if (this.cut === this.ways.polygon && !measuring.isOn) this.cut.add(x, y);
    });
  }

  /** Cut in a way by its name; none without one. */
  turn(name) {
    const wasDrawn = this.cut === this.ways.polygon;
    this.cut?.stop();
    this.cut = this.ways[name] ?? null;
    for (const id of ['cut-polygon', 'cut-pieces']) {
      if (find(id)) find(id).hidden = id !== `cut-${name}`;
    }
    find('cut-tools').hidden = !this.cut;
    if (wasDrawn || this.cut === this.ways.polygon) this.look(this.cut === this.ways.polygon);
    if (this.cut) this.cut.start(); else this.kept.all();
  }

  /** Copy the command; where the browser does not let a page do that, it is marked. */
  async copy() {
    try {
      await navigator.clipboard.writeText(find('cut-command').textContent);
      find('cut-copied').textContent = 'copied';
    } catch {
      getSelection().selectAllChildren(find('cut-command'));
      find('cut-copied').textContent = 'marked: copy it';
    }
  }

  #say() {
    const { option, said } = this.cut;
    find('cut-said').textContent = said;
    find('cut-run').hidden = !option;
    find('cut-save').disabled = !option;
    find('cut-undo').disabled = !this.ways.polygon.corners.length;
    find('cut-copied').textContent = '';
    const command = this.commands[Number(find('cut-into')?.value ?? 0)];
    find('cut-command').textContent = `${command.text} ${option}`;
  }
}
