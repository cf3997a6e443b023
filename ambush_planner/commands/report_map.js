'use strict';
// The maps of a report: pan, zoom, layers, single departures, a reading at the pointer.
// Positions are metres from the risk map's corner, along the world's axes.

const LEAST = 1e-3; // Of all shown probabilities, and of the shares of the value that are no 0.
const CLASSES = 12; // Number of colours and widths of edges.
const OBSTACLE = 255;
const [FULL, SECURED, NOBODY] = [250, 254, 255]; // codes of costs, as in report_data.py
const PRINTED = [480, 5]; // Width of a printed map in CSS pixels, and dots for each of them.
const TYPES = {
  cells: Uint8Array, costs: Uint8Array, segments: Float32Array, shown: Float32Array,
  sites: Float32Array, routes: Float32Array,
};

async function unpack(text, Type) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Type(await new Response(stream).arrayBuffer());
}

// The colours of a CSS variable, as texts.
function colours(name) {
  const style = getComputedStyle(document.documentElement);
  return style.getPropertyValue(`--${name}`).split(',').map((text) => text.trim());
}

const rgb = (colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));

// The colour [red, green, blue] at a share, 0..1, of a ramp.
function between(ramp, share) {
  const at = share * (ramp.length - 1), k = Math.min(Math.floor(at), ramp.length - 2);
  const [low, high] = [rgb(ramp[k]), rgb(ramp[k + 1])];
  return low.map((c, i) => Math.round(c + (at - k) * (high[i] - c)));
}

const pixel = ([red, green, blue]) => (255 << 24 | blue << 16 | green << 8 | red) >>> 0;
const digits = (number, count = 3) => Number(number.toPrecision(count)).toString();

class View {
  constructor(figure, data) {
    const section = figure.closest('section');
    Object.assign(this, { section, data });
    this.canvas = figure.querySelector('canvas');
    this.pen = this.canvas.getContext('2d');
    this.layers = Object.fromEntries(
      [...section.querySelectorAll('[data-layer]')].map((box) => [box.dataset.layer, box]));
    this.rows = [...section.querySelectorAll('.departures tbody tr')];
    this.picked = -1; // the row of the only departure that is shown; -1: all are
    this.reading = figure.querySelector('.reading');
    this.circle = figure.querySelector('.reach');
    this.fingers = new Map();
    this.ground = this.#paint(true);
    this.bare = this.#paint(false);
    this.stretches = this.#stretches();
    this.lines = this.#lines();
    this.#listen();
    this.showAll();
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
  }

  // The map as a picture, a pixel a cell: losses in grey, or obstacles only.
  #paint(losses) {
    const { columns, rows, cells, levels } = this.data;
    const picture = new OffscreenCanvas(columns, rows), pen = picture.getContext('2d');
    const image = pen.createImageData(columns, rows), pixels = new Uint32Array(image.data.buffer);
    const most = Math.max(...levels), span = most - Math.min(...levels) || 1;
    const ramp = colours('risk'), [black] = colours('obstacle').map(rgb).map(pixel);
    const grey = levels.map((loss) => pixel(between(ramp, 1 - (most - loss) / span)));
    cells.forEach((level, k) => {
      const at = (rows - 1 - Math.floor(k / columns)) * columns + k % columns;
      pixels[at] = level === OBSTACLE ? black : losses ? grey[level] : 0;
    });
    pen.putImageData(image, 0, 0);
    return picture;
  }

  // Stretches in use by how likely they are, layers as one: a path, colour and width for each class.
  #stretches() {
    const { segments, shown } = this.data;
    const most = shown.reduce((a, b) => Math.max(a, b), 2 * LEAST);
    const ramp = colours('chances');
    const classes = Array.from({ length: CLASSES }, (_, k) => {
      const share = k / (CLASSES - 1), colour = `rgb(${between(ramp, share)})`;
      return { path: new Path2D(), colour, width: 0.5 + 2.5 * share ** 2 };
    });
    shown.forEach((p, k) => {
      const share = Math.log(p / LEAST) / Math.log(most / LEAST);
      const { path } = classes[Math.min(Math.floor(share * CLASSES), CLASSES - 1)];
      path.moveTo(segments[4 * k], segments[4 * k + 1]);
      path.lineTo(segments[4 * k + 2], segments[4 * k + 3]);
    });
    return classes;
  }

  // The pieces of the routes.
  #lines() {
    let at = 0;
    return this.data.pieces.map(([row, count, over]) => {
      const path = new Path2D();
      for (let k = 0; k < count; k += 1, at += 2) {
        path.lineTo(this.data.routes[at], this.data.routes[at + 1]);
      }
      return { row, over, path };
    });
  }

  // The value at a place of a raster of squares: undefined off the map.
  #at(raster, side, columns, x, y) {
    const { yaw } = this.data;
    const column = Math.floor((x * Math.cos(yaw) + y * Math.sin(yaw)) / side);
    const row = Math.floor((y * Math.cos(yaw) - x * Math.sin(yaw)) / side);
    return column < 0 || row < 0 || column >= columns ? undefined : raster[row * columns + column];
  }

  showAll() {
    const { box: [left, bottom, right, top] } = this.data;
    [this.x, this.y] = [(left + right) / 2, (bottom + top) / 2];
    this.zoom = 1;
    this.#resize();
  }

  #resize(width = this.canvas.clientWidth, fine = window.devicePixelRatio || 1) {
    const { box: [left, bottom, right, top] } = this.data;
    const height = width * this.canvas.clientHeight / this.canvas.clientWidth;
    Object.assign(this, { width, height, fine });
    Object.assign(this.canvas, { width: width * fine, height: height * fine });
    this.whole = 0.97 * Math.min(width / (right - left), height / (top - bottom));
    this.#draw();
  }

  get scale() { return this.whole * this.zoom; }

  place(px, py) {
    return [this.x + (px - this.width / 2) / this.scale,
      this.y - (py - this.height / 2) / this.scale];
  }

  zoomBy(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.place(px, py);
    const zoom = Math.min(Math.max(this.zoom * factor, 1), 200);
    this.x = x + (this.x - x) * this.zoom / zoom;
    this.y = y + (this.y - y) * this.zoom / zoom;
    this.zoom = zoom;
    this.draw();
  }

  move(px, py) {
    const { box: [left, bottom, right, top] } = this.data;
    this.x = Math.min(Math.max(this.x - px / this.scale, left), right);
    this.y = Math.min(Math.max(this.y + py / this.scale, bottom), top);
    this.draw();
  }

  draw() {
    if (!this.drawing) this.drawing = requestAnimationFrame(() => this.#draw());
  }

  #draw() {
    this.drawing = 0;
    const { pen, data, scale, fine } = this, { yaw, cell, columns, rows, discs } = data;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    pen.setTransform(fine * scale, 0, 0, -fine * scale,
      fine * (this.width / 2 - this.x * scale), fine * (this.height / 2 + this.y * scale));
    Object.assign(pen, { lineCap: 'round', lineJoin: 'round', imageSmoothingEnabled: false });
    pen.save();
    pen.rotate(yaw);
    pen.scale(cell, -cell);
    pen.drawImage(this.layers.risk.checked ? this.ground : this.bare, 0, -rows, columns, rows);
    pen.restore();
    this.#drawGrid();
    if (this.layers.chances.checked) {
      for (const { path, colour, width } of this.stretches) this.#stroke(path, colour, width);
    }
    for (const each of discs) this.#stroke(disc(...each), 'white', 4);
    pen.setLineDash([7 / scale, 5 / scale]);
    for (const each of discs) this.#stroke(disc(...each), 'black', 2);
    pen.setLineDash([]);
    if (this.layers.routes.checked) this.#drawRoutes();
    if (this.layers.sites.checked) this.#drawSites();
    data.ends.forEach(([x, y], k) => this.#drawEnd(x, y, ['start', 'goal'][k] || `stop ${k - 1}`));
    this.#drawScale();
    this.#drawCoordinates();
    this.#drawNorth();
  }

  #stroke(path, colour, width) {
    Object.assign(this.pen, { strokeStyle: colour, lineWidth: width / this.scale });
    this.pen.stroke(path);
  }

  // All routes, those that follow one road as stripes of one line, or the chosen one.
  #drawRoutes() {
    const [thin] = colours('accent'), all = this.picked < 0;
    const shown = this.lines.filter(({ row }) => all || row === this.picked)
      .map(({ row, over, path }) => {
        const colour = this.data.colours[row], width = all ? 1.8 + 1.8 * over : 3;
        return { path, colour, width: colour || !all ? width : 0.8 };
      });
    for (const { path, colour, width } of shown) {
      if (colour || !all) this.#stroke(path, 'white', width + 2);
    }
    for (const { path, colour, width } of shown) this.#stroke(path, colour || thin, width);
  }

  #drawSites() {
    const { sites } = this.data, size = Math.min(1, 0.4 + this.width / 1200) / this.scale;
    [this.pen.fillStyle] = colours('ambusher');
    for (let k = 0; k < sites.length; k += 3) {
      const path = disc(sites[k], sites[k + 1], (3 + 5 * Math.sqrt(sites[k + 2])) * size);
      this.pen.fill(path);
      this.#stroke(path, 'white', 1.5);
    }
  }

  #drawEnd(x, y, name) {
    const path = ({ start: square, goal: star }[name] || disc)(x, y, 6 / this.scale);
    [this.pen.fillStyle] = colours('ends');
    this.pen.fill(path);
    this.#stroke(path, 'black', 1.2);
    this.#label(name, x, y, 24);
  }

  // Write a text so many pixels below a place, unless the place is to the side of the picture.
  #label(text, x, y, below) {
    const px = (x - this.x) * this.scale + this.width / 2;
    if (px < 0 || px > this.width) return;
    this.#write(text, px, (this.y - y) * this.scale + this.height / 2 + below);
  }

  // Write a text whose base line is centred at a place of the canvas, or as near as fits.
  #write(text, px, py, style = 'bold 14px') {
    const { pen, width, fine } = this;
    pen.save();
    pen.setTransform(fine, 0, 0, fine, 0, 0);
    Object.assign(pen, { font: `${style} system-ui, sans-serif`, textAlign: 'center',
      lineWidth: 3, strokeStyle: 'white', fillStyle: 'black' });
    const half = pen.measureText(text).width / 2 + 2;
    const at = [Math.min(Math.max(px, half), width - half), py];
    pen.strokeText(text, ...at);
    pen.fillText(text, ...at);
    pen.restore();
  }

  // Round coordinates of the world in view: their distance, and those of x and of y.
  #round() {
    const [u, v] = this.data.origin, step = round(200 / this.scale);
    const [left, top] = this.place(0, 0), [right, bottom] = this.place(this.width, this.height);
    const between = (from, to) => Array.from(
      { length: Math.floor(to / step) - Math.ceil(from / step) + 1 },
      (_, k) => (Math.ceil(from / step) + k) * step);
    return { step, xs: between(left + u, right + u), ys: between(bottom + v, top + v) };
  }

  #drawGrid() {
    const { xs, ys } = this.#round(), [u, v] = this.data.origin, path = new Path2D();
    const [left, top] = this.place(0, 0), [right, bottom] = this.place(this.width, this.height);
    for (const x of xs) { path.moveTo(x - u, bottom); path.lineTo(x - u, top); }
    for (const y of ys) { path.moveTo(left, y - v); path.lineTo(right, y - v); }
    this.#stroke(path, '#0004', 1);
  }

  // Name the lines of the grid: x along the upper edge, y along the left one.
  #drawCoordinates() {
    const { step, xs, ys } = this.#round(), [u, v] = this.data.origin;
    const far = step >= 1000 || Math.max(...[...xs, ...ys].map(Math.abs)) >= 10000;
    const name = (at) => (far ? `${Number((at / 1000).toFixed(3))} km`
      : `${Number(at.toFixed(2))} m`);
    const { width, height, scale } = this;
    for (const x of xs) {
      const px = (x - u - this.x) * scale + width / 2;
      if (px > 40 && px < width - 40) this.#write(name(x), px, 14, '12px');
    }
    for (const y of ys) {
      const py = (this.y - y + v) * scale + height / 2;
      if (py > 30 && py < height - 50) this.#write(name(y), 0, py + 4, '12px');
    }
  }

  // Point to true north in the upper right corner, where the map's system says it.
  #drawNorth() {
    if (!this.data.degrees) return;
    const { pen, fine, width } = this, [u, v] = this.data.origin, step = 1 / this.scale;
    const [, here] = this.#latLon(this.x + u, this.y + v); // longitudes
    const [, right] = this.#latLon(this.x + u + step, this.y + v);
    const [, above] = this.#latLon(this.x + u, this.y + v + step);
    pen.save();
    pen.setTransform(fine, 0, 0, fine, 0, 0);
    pen.translate(width - 20, 30);
    pen.rotate(Math.atan2(here - above, right - here));
    const arrow = new Path2D('M 0 16 L 0 -4 M 0 -18 L -6 -4 L 6 -4 Z');
    Object.assign(pen, { lineWidth: 4, strokeStyle: 'white', fillStyle: 'black' });
    pen.stroke(arrow);
    Object.assign(pen, { lineWidth: 1.5, strokeStyle: 'black' });
    pen.stroke(arrow);
    pen.fill(arrow);
    pen.restore();
    this.#write('N', width - 20, 60);
  }

  #drawScale() {
    const metres = round(0.3 * this.width / this.scale);
    const [x, y] = this.place(10, this.height - 10), path = new Path2D();
    path.moveTo(x, y);
    path.lineTo(x + metres, y);
    this.#stroke(path, 'white', 6);
    this.#stroke(path, 'black', 3);
    this.#label(this.#far(metres), x + metres / 2, y, -8);
  }

  #far(metres) { return metres >= 1000 ? `${digits(metres / 1000)} km` : `${digits(metres)} m`; }

  // Latitude and longitude of world coordinates; undefined if they are unknown.
  #latLon(x, y) {
    const { degrees } = this.data;
    if (!degrees) return undefined;
    const [s, t] = [x, y].map((at, k) => (at - degrees.middle[k]) / degrees.half[k]);
    const horner = (terms, at) => terms.reduceRight((sum, term) => sum * at + term, 0);
    return [degrees.lat, degrees.lon].map((rows) => horner(rows.map((row) => horner(row, t)), s));
  }

  // What an ambush at a place would cost, in words.
  words(x, y) {
    const { value, origin, cell, cells, columns, levels } = this.data;
    const level = this.#at(cells, cell, columns, x, y);
    if (level === undefined) return 'Outside the map';
    const [u, v] = [x + origin[0], y + origin[1]], places = cell < 1 ? 1 : 0;
    const risk = level === OBSTACLE ? '' : `risk ${digits(levels[level])}; `;
    return `${this.#verdict(x, y)}\n${risk}the best ambush costs ${digits(value)}\n`
      + `x ${u.toFixed(places)} m, y ${v.toFixed(places)} m`
      + (this.#latLon(u, v) || []).map((each, k) => (k ? ', ' : '\n') + each.toFixed(5)).join('');
  }

  #verdict(x, y) {
    const { costs, block, blocks, reach, most_cost: most, value } = this.data;
    const code = this.#at(costs, block, blocks, x, y), cost = most * code / FULL;
    if (code === SECURED) return 'Secured area: nobody can wait here';
    if (code === NOBODY) return 'Obstacle';
    const loss = cost < 2 * LEAST * value ? 'practically nothing' : digits(cost, 2);
    return `An ambush ${reach > 0 ? 'here' : 'at the nearest node'} costs ${loss} on average`;
  }

  // Show the reach and the reading at a place of the canvas; the reading never covers the place.
  tell(px, py) {
    const { circle, reading } = this, across = `${2 * this.data.reach * this.scale}px`;
    Object.assign(circle.style, { left: `${px}px`, top: `${py}px`, width: across, height: across,
      display: 'block' });
    reading.textContent = this.words(...this.place(px, py));
    reading.hidden = false;
    const { offsetWidth: wide, offsetHeight: high } = reading;
    reading.style.left = `${Math.min(Math.max(px - wide / 2, 2), this.width - wide - 2)}px`;
    reading.style.top = `${py > this.height / 2 ? py - high - 16 : py + 16}px`;
  }

  #tellNothing() {
    this.circle.style.display = 'none';
    this.reading.hidden = true;
  }

  // Show one departure alone, or all again.
  #pick(row) {
    this.picked = this.picked === row ? -1 : row;
    this.rows.forEach((each, k) => {
      each.querySelector('button').ariaPressed = String(k === this.picked);
    });
    this.canvas.scrollIntoView({ block: 'nearest' });
    this.draw();
  }

  #listen() {
    const { canvas, section } = this;
    for (const box of Object.values(this.layers)) box.addEventListener('change', () => this.draw());
    this.rows.forEach((row, k) => row.addEventListener('click', (event) => {
      if (!event.target.closest('a')) this.#pick(k);
    }));
    window.addEventListener('beforeprint', () => this.#resize(...PRINTED));
    window.addEventListener('afterprint', () => this.#resize());
    const actions = { in: () => this.zoomBy(1.5), out: () => this.zoomBy(1 / 1.5),
      all: () => this.showAll() };
    for (const button of section.querySelectorAll('[data-zoom]')) {
      button.addEventListener('click', actions[button.dataset.zoom]);
    }
    canvas.addEventListener('keydown', (event) => this.#key(event, actions));
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.fingers.set(event.pointerId, event);
    });
    for (const end of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(end, (event) => this.fingers.delete(event.pointerId));
    }
    canvas.addEventListener('pointermove', (event) => this.#pointer(event));
    canvas.addEventListener('pointerleave', (event) => {
      if (event.pointerType === 'mouse') this.#tellNothing();
    });
    canvas.addEventListener('blur', () => this.#tellNothing());
    // The wheel scrolls the page until the map has been clicked; pinching a touchpad is ctrl.
    canvas.addEventListener('wheel', (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY / (event.ctrlKey ? 100 : 400)), event.offsetX,
        event.offsetY);
      this.tell(event.offsetX, event.offsetY);
    }, { passive: false });
  }

  #pointer(event) {
    const before = this.fingers.get(event.pointerId);
    if (before) {
      const other = [...this.fingers.values()].find((each) => each.pointerId !== event.pointerId);
      const apart = (one) => Math.hypot(one.offsetX - other.offsetX, one.offsetY - other.offsetY);
      if (other) this.zoomBy(apart(event) / (apart(before) || 1), other.offsetX, other.offsetY);
      else this.move(event.offsetX - before.offsetX, event.offsetY - before.offsetY);
      this.fingers.set(event.pointerId, event);
    }
    this.tell(event.offsetX, event.offsetY);
  }

  #key(event, actions) {
    const step = 0.1 * this.width;
    const keys = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step],
      ArrowDown: [0, -step] };
    const zooms = { '+': 'in', '=': 'in', '-': 'out', 0: 'all' };
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (keys[event.key]) this.move(...keys[event.key]);
    else if (zooms[event.key]) actions[zooms[event.key]]();
    else return;
    event.preventDefault();
    this.tell(this.width / 2, this.height / 2);
  }
}

// The largest of 1, 2, 5, 10, ... up to a number.
function round(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].find((n) => n * power <= most) * power;
}

function disc(x, y, radius) {
  const path = new Path2D();
  path.arc(x, y, radius, 0, 2 * Math.PI);
  return path;
}

function square(x, y, half) {
  const path = new Path2D();
  path.rect(x - half, y - half, 2 * half, 2 * half);
  return path;
}

function star(x, y, half) {
  const path = new Path2D();
  for (let k = 0; k < 10; k += 1) {
    const far = (k % 2 ? 0.8 : 2) * half, angle = Math.PI * (0.5 + k / 5);
    path.lineTo(x + far * Math.cos(angle), y + far * Math.sin(angle));
  }
  path.closePath();
  return path;
}

async function show(figure) {
  try {
    const data = JSON.parse(figure.querySelector('script').textContent);
    for (const [name, Type] of Object.entries(TYPES)) data[name] = await unpack(data[name], Type);
    figure.view = new View(figure, data);
    figure.classList.add('live');
  } catch (error) {
    figure.querySelector('figcaption').textContent = `This browser cannot show the map: ${error}`;
    throw error;
  }
}

window.maps = Promise.all([...document.querySelectorAll('figure')].map(show));
