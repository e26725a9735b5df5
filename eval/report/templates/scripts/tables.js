// Tables sort by a click on a heading; searching hides the rows that lack the words.
function valueOf(row, column) {
  const cell = row.cells[column];
  const text = cell?.dataset.v ?? cell?.textContent.trim() ?? '';
  const number = Number.parseFloat(text.replace('−', '-'));
  return Number.isNaN(number) ? text : number;
}

function compare(a, b) {
  if (typeof a === 'number' && typeof b === 'number') return a - b;
  if (typeof a === typeof b) return a.localeCompare(b);
  return typeof a === 'number' ? -1 : 1;
}

function sortBy(table, heading) {
  const ascending = heading.getAttribute('aria-sort') !== 'ascending';
  for (const other of table.tHead.rows[0].cells) other.removeAttribute('aria-sort');
  heading.setAttribute('aria-sort', ascending ? 'ascending' : 'descending');
  const rows = [...table.tBodies[0].rows];
  rows.sort((a, b) => compare(valueOf(a, heading.cellIndex), valueOf(b, heading.cellIndex)) * (ascending ? 1 : -1));
  table.tBodies[0].append(...rows);
}

for (const table of document.querySelectorAll('table.sortable')) {
  table.classList.add('on');
  for (const heading of table.tHead.rows[0].cells) {
    heading.tabIndex = 0;
    heading.addEventListener('click', () => sortBy(table, heading));
    heading.addEventListener('keydown', event => { if (event.key === 'Enter') sortBy(table, heading); });
  }
}

for (const input of document.querySelectorAll('[data-filter]')) {
  const rows = document.getElementById(input.dataset.filter).tBodies[0].rows;
  input.disabled = false;
  input.addEventListener('input', () => {
    const wanted = input.value.toLowerCase();
    for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
  });
}
