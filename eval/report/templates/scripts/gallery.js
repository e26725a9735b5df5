// The gallery by result, group, person and part; a chosen part puts its worst frames first.
function partScores(figure) {
  return new Map(figure.dataset.iou.trim().split(' ').filter(Boolean).map(pair => pair.split(':').map(Number)));
}

function filterGallery(controls, cards) {
  const by = Object.fromEntries([...controls.querySelectorAll('select')].map(s => [s.dataset.by, s.value]));
  const part = Number(by.part);
  let shown = 0;
  for (const card of cards) {
    const figures = [...card.querySelectorAll('figure')];
    for (const figure of figures) {
      const iou = part ? partScores(figure).get(part) : undefined;
      figure.dataset.score = iou ?? '';
      figure.querySelector('.of-part').textContent = part && iou !== undefined ? ` · this part’s IoU ${iou.toFixed(3)}` : '';
      figure.hidden = (by.result && by.result !== card.dataset.result) || (by.group && by.group !== figure.dataset.group)
        || (by.subject && by.subject !== figure.dataset.subject) || (part > 0 && iou === undefined);
      shown += figure.hidden ? 0 : 1;
    }
    const rank = part ? figure => Number(figure.dataset.score || 2) : figure => Number(figure.dataset.place);
    card.append(...figures.sort((a, b) => rank(a) - rank(b)));
    card.hidden = figures.every(figure => figure.hidden);
  }
  controls.querySelector('output').textContent = `${shown} shown`;
}

const galleryControls = document.querySelector('[data-gallery]');
if (galleryControls) {
  const cards = [...document.querySelectorAll('#gallery .gallery')];
  for (const card of cards) card.querySelectorAll('figure').forEach((figure, place) => { figure.dataset.place = place; });
  galleryControls.hidden = false;
  galleryControls.addEventListener('change', () => filterGallery(galleryControls, cards));
  filterGallery(galleryControls, cards);
}
