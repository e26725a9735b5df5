"use strict";
const figures = JSON.parse(document.getElementById("data").textContent);
const ink = () => ({ "font.color": getComputedStyle(document.body).color });
const draw = (place) => {
  const { data, layout } = figures[place.dataset.figure];
  Plotly.newPlot(place, data, { ...layout, font: { color: ink()["font.color"] } }, { responsive: true, displayModeBar: false });
};
const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) if (entry.isIntersecting) { seen.unobserve(entry.target); draw(entry.target); }
}, { rootMargin: "600px" });
const places = [...document.querySelectorAll("[data-figure]")];
for (const place of places) figures[place.dataset.figure].layout.scene ? seen.observe(place) : draw(place);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const place of places) if (place.data) Plotly.relayout(place, ink());
});
