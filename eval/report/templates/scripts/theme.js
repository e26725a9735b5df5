// Light or dark: as the system has it until the reader chooses.
const root = document.documentElement;
const systemDark = matchMedia('(prefers-color-scheme: dark)');
const themeButton = document.getElementById('theme');
const drawnAgain = [];

function setTheme(dark) {
  root.classList.toggle('dark', dark);
  themeButton.textContent = dark ? 'Light' : 'Dark';
  for (const draw of drawnAgain) draw();
}

themeButton.hidden = false;
themeButton.addEventListener('click', () => setTheme(!root.classList.contains('dark')));
systemDark.addEventListener('change', event => setTheme(event.matches));
setTheme(systemDark.matches);
