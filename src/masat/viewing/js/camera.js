// How the map is seen: from above in 2D, in perspective in 3D; flights from one place to another.

const FIELD_OF_VIEW = 40;
const FLIGHT_MS = 450;
// From where 3D maps are seen first: from the side and above, as in masat.plot.
const OBLIQUE = [-0.6, -1, 0.75];
export const VIEWS = { oblique: OBLIQUE, top: [0, -1e-4, 1], front: [0, -1, 0], side: [1, 0, 0] };

export class Camera {
  /** `changed` is called whenever something else is seen. */
  constructor(canvas, halves, changed) {
    this.canvas = canvas;
    this.is3d = halves.length === 3;
    // Half of the box around the map, and of its diagonal.
    this.halves = halves;
    this.radius = Math.max(Math.hypot(...halves), 1e-3);
    this.changed = changed;
    // Pixels of the window that the panel covers on the right.
    this.covered = 0;
    this.camera = this.is3d
      ? new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.1, 10)
      : new THREE.OrthographicCamera(-1, 1, 1, -1, 0.1, 10);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.controls.enableDamping = false;
    this.controls.zoomSpeed = 1.6;
    if (!this.is3d) {
      this.controls.maxPolarAngle = 0;
      this.controls.mouseButtons = { LEFT: THREE.MOUSE.PAN, MIDDLE: THREE.MOUSE.DOLLY, RIGHT: THREE.MOUSE.ROTATE };
      this.controls.touches = { ONE: THREE.TOUCH.PAN, TWO: THREE.TOUCH.DOLLY_ROTATE };
    }
    this.controls.addEventListener("change", changed);
    this.controls.addEventListener("start", () => { this.flight = null; });
    this.resize();
    this.look(OBLIQUE);
  }

  resize() {
    const width = this.canvas.clientWidth || 1, height = this.canvas.clientHeight || 1;
    this.width = width;
    this.height = height;
    // The middle of the uncovered part is the middle of the view.
    this.camera.setViewOffset(width, height, this.covered / 2, 0, width, height);
    if (this.is3d) {
      this.camera.aspect = width / height;
    } else {
      // One meter a pixel at zoom 1.
      Object.assign(this.camera, { left: -width / 2, right: width / 2, top: height / 2, bottom: -height / 2 });
    }
    this.camera.updateProjectionMatrix();
    this.changed();
  }

  /** Pixels a meter at what the camera looks at. */
  get pixelsPerMeter() {
    if (!this.is3d) return this.camera.zoom;
    return this.height / (2 * Math.tan((FIELD_OF_VIEW * Math.PI) / 360) * this._distance());
  }

  /** Look at the whole map from a direction. */
  look(direction = this.direction) {
    this.flight = null;
    this.direction = direction;
    this.controls.target.set(0, 0, 0);
    if (this.is3d) {
      const [x, y, z] = direction, length = Math.hypot(x, y, z);
      this.camera.position.set(x / length, y / length, z / length);
    } else {
      this.camera.position.set(0, 0, 10 * this.radius);
    }
    this._setScale(this.is3d ? this._scaleFor(0.8 * this.radius) : this._scaleForBox());
    this.controls.update();
    this.changed();
  }

  /** Fly to a point, so that a ball around it fills about half of the view. */
  fly(point, radius) {
    const reduced = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.flight = {
      from: this.controls.target.clone(), to: new THREE.Vector3(...point),
      fromScale: this._scale(), toScale: this._scaleFor(radius * 2),
      begin: performance.now(), duration: reduced ? 1 : FLIGHT_MS,
    };
    this.changed();
  }

  /** Go nearer by a factor. */
  zoomBy(factor) {
    this.flight = null;
    this._setScale(this._scale() * (this.is3d ? 1 / factor : factor));
    this.controls.update();
    this.changed();
  }

  /** Move along a flight, and set the depths that are drawn; return whether the flight goes on. */
  advance(now) {
    const flight = this.flight;
    if (flight) {
      const part = Math.min(1, Math.max(0, (now - flight.begin) / flight.duration));
      const eased = part * part * (3 - 2 * part);
      const offset = this.camera.position.clone().sub(this.controls.target);
      this.controls.target.lerpVectors(flight.from, flight.to, eased);
      this.camera.position.copy(this.controls.target).add(offset);
      this._setScale(flight.fromScale * (flight.toScale / flight.fromScale) ** eased);
      this.controls.update();
      if (part === 1) this.flight = null;
    }
    this._setDepths();
    return this.flight !== null && this.flight !== undefined;
  }

  /** The matrix from positions to the screen's unit cube. */
  matrix() {
    this.camera.updateMatrixWorld();
    return new THREE.Matrix4().multiplyMatrices(this.camera.projectionMatrix, this.camera.matrixWorldInverse);
  }

  _distance() { return this.camera.position.distanceTo(this.controls.target); }
  _scale() { return this.is3d ? this._distance() : this.camera.zoom; }

  _scaleFor(radius) {
    const free = Math.min(this.width - this.covered, this.height);
    if (!this.is3d) return (0.92 * free) / (2 * radius);
    return radius / Math.sin((FIELD_OF_VIEW * Math.PI) / 360) * (this.height / free);
  }

  _setScale(scale) {
    if (this.is3d) {
      const offset = this.camera.position.clone().sub(this.controls.target).setLength(scale);
      this.camera.position.copy(this.controls.target).add(offset);
    } else {
      this.camera.zoom = scale;
      this.camera.updateProjectionMatrix();
    }
  }

  _scaleForBox() {
    const [x, y] = this.halves.map((half) => Math.max(half, 0.02 * this.radius));
    return 0.46 * Math.min((this.width - this.covered) / x, this.height / y);
  }

  _setDepths() {
    const distance = this._distance();
    const far = this.camera.position.length() + 4 * this.radius;
    Object.assign(this.camera, this.is3d
      ? { near: Math.max(distance * 0.02, far * 1e-4), far }
      : { near: 0, far: distance * 2 });
    this.camera.updateProjectionMatrix();
  }
}
