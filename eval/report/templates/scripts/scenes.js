// Point clouds: drawn when they come into view, since a 3D context is dear.
const stage = document.getElementById('stage');
const COLOR_NAMES = {truth: 'Target labels', predicted: 'Predicted labels', error: 'Errors', temperature_c: 'Temperature'};
const FRONT = {eye: {x: 0, y: -1.7, z: 0.05}, up: {x: 0, y: 0, z: 1}, center: {x: 0, y: 0, z: 0}};
const ARRAYS = {i2: Int16Array, u1: Uint8Array, f4: Float32Array};

function unpacked({dtype, bdata}) {
  const bytes = Uint8Array.from(atob(bdata), letter => letter.charCodeAt(0));
  return new ARRAYS[dtype](bytes.buffer);
}

function coordinate(points, axis, sign) {
  return Float32Array.from({length: points.length / 3}, (_, i) => sign * points[3 * i + axis] / 1000);
}

function marker(scene, by) {
  const values = unpacked(scene.colors[by]);
  const size = 2.4;
  if (by === 'temperature_c') {
    const scale = page.temperature;
    return {text: Array.from(values, v => `${v.toFixed(1)} °C`), size, opacity: 1, color: values, colorscale: 'Inferno', cmin: scale[0], cmax: scale[1],
      colorbar: {title: {text: '°C', font: {color: '#ddd'}}, tickfont: {color: '#ddd'}, thickness: 12, len: 0.6}};
  }
  const palette = page.palettes[by];
  return {text: Array.from(values, v => palette.names[v]), size, opacity: 1, color: Array.from(values, v => palette.colors[v])};
}

function legendOf(scene, by) {
  const legend = document.getElementById('scene-legend');
  legend.replaceChildren();
  if (by === 'temperature_c') return;
  const palette = page.palettes[by];
  for (const id of [...new Set(unpacked(scene.colors[by]))].sort((a, b) => a - b)) {
    const entry = document.createElement('span');
    const swatch = document.createElement('i');
    swatch.className = 'swatch';
    swatch.style.background = palette.colors[id];
    entry.append(swatch, palette.names[id]);
    legend.append(entry);
  }
}

function drawScene(camera) {
  const scene = page.scenes[document.getElementById('scene').value];
  const by = document.getElementById('scene-color').value;
  const points = unpacked(scene.points_mm);
  const {text, ...marks} = marker(scene, by);
  const hidden = {visible: false, showspikes: false};
  legendOf(scene, by);
  // Camera: x right, y down, z forward. Plotly: z up; the viewer stands at the camera.
  return Plotly.react(stage, [{type: 'scatter3d', mode: 'markers', x: coordinate(points, 0, 1), y: coordinate(points, 2, 1),
    z: coordinate(points, 1, -1), marker: marks, text, hoverinfo: 'text'}],
  {margin: {l: 0, r: 0, t: 0, b: 0}, paper_bgcolor: '#18181c', uirevision: 'kept',
    scene: {xaxis: hidden, yaxis: hidden, zaxis: hidden, aspectmode: 'data', bgcolor: '#18181c', dragmode: 'orbit', camera}},
  {displayModeBar: false, displaylogo: false, responsive: true, scrollZoom: true});
}

function offerColors() {
  const scene = page.scenes[document.getElementById('scene').value];
  const select = document.getElementById('scene-color');
  const before = select.value;
  select.replaceChildren(...Object.keys(scene.colors).map(by => new Option(COLOR_NAMES[by], by)));
  if (before in scene.colors) select.value = before;
}

let angle = 0;
function turn() {
  const pressed = document.getElementById('scene-turn').getAttribute('aria-pressed') === 'true';
  if (!pressed) return;
  angle += 0.012;
  const eye = {x: 1.7 * Math.sin(angle), y: -1.7 * Math.cos(angle), z: 0.2};
  Plotly.relayout(stage, {'scene.camera': {...FRONT, eye}}).then(() => requestAnimationFrame(turn));
}

function startScenes() {
  drawScene(FRONT);
  document.getElementById('scene').addEventListener('change', () => { offerColors(); drawScene(FRONT); });
  document.getElementById('scene-color').addEventListener('change', () => drawScene(stage.layout.scene.camera));
  document.getElementById('scene-front').addEventListener('click', () => { angle = 0; Plotly.relayout(stage, {'scene.camera': FRONT}); });
  document.getElementById('scene-turn').addEventListener('click', event => {
    const button = event.currentTarget;
    button.setAttribute('aria-pressed', button.getAttribute('aria-pressed') !== 'true');
    turn();
  });
}

if (stage) {
  offerColors();
  const seen = new IntersectionObserver(entries => {
    if (entries.some(entry => entry.isIntersecting)) { seen.disconnect(); startScenes(); }
  }, {rootMargin: '200px'});
  seen.observe(stage);
}
