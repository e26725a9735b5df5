// Figures come as plotly's JSON with colours by the style sheet's names: var(--ink).
const page = JSON.parse(document.getElementById('data').textContent);
const CONFIG = {displayModeBar: false, displaylogo: false, responsive: true, showTips: false, scrollZoom: false};
const PRINTED_PX = 640;

function colored(value, style) {
  if (typeof value === 'string') {
    return value.startsWith('var(--') ? style.getPropertyValue(value.slice(4, -1)).trim() : value;
  }
  if (Array.isArray(value)) return value.map(entry => colored(entry, style));
  if (value === null || typeof value !== 'object') return value;
  return Object.fromEntries(Object.entries(value).map(([key, entry]) => [key, colored(entry, style)]));
}

function axis(own, style) {
  const line = style.getPropertyValue('--line').trim();
  return {gridcolor: line, zerolinecolor: style.getPropertyValue('--soft').trim(), automargin: true, fixedrange: true, ...own};
}

function drawFigure(element, width) {
  const style = getComputedStyle(root);
  const {data, layout} = colored(page.figures[element.dataset.figure], style);
  const ink = style.getPropertyValue('--ink').trim();
  const card = style.getPropertyValue('--card').trim();
  return Plotly.react(element, data, {
    ...layout, width, autosize: !width, paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)',
    font: {family: getComputedStyle(document.body).fontFamily, size: 12, color: ink},
    hoverlabel: {bgcolor: card, bordercolor: style.getPropertyValue('--line').trim(), font: {color: ink}},
    xaxis: axis(layout.xaxis, style), yaxis: axis(layout.yaxis, style),
  }, CONFIG);
}

const figures = [...document.querySelectorAll('[data-figure]')];
const drawAll = () => figures.forEach(element => drawFigure(element));
drawAll();
drawnAgain.push(drawAll);

// Paper is narrower than the screen, and always light.
const opened = [];
addEventListener('beforeprint', () => {
  for (const details of document.querySelectorAll('details:not([open]):not(.screen)')) { details.open = true; opened.push(details); }
  // Drawn anew: a legend that was laid out for another width would overlap.
  figures.forEach(element => { Plotly.purge(element); drawFigure(element, PRINTED_PX); });
});
addEventListener('afterprint', () => {
  while (opened.length) opened.pop().open = false;
  figures.forEach(element => { Plotly.purge(element); drawFigure(element); });
});
