"""The hole plate as a drawing to scale (SVG), to print, drill or cut by laser."""

from sensors.calibrate.hole_plate import HolePlate

MARGIN_MM = 12.0
"""Millimetres about the plate, with the text and the line to measure. Chosen by eye."""


def plate_svg(plate: HolePlate) -> str:
    """The drawing: outline, holes with their centres, their sizes, and a line of 100 mm for checking."""
    low, high = 1000 * plate.size_m
    width, height = high - low
    centers = 1000 * plate.centers_m - low
    hole, row = 1000 * plate.hole_m, 1000 * plate.pitch_m
    holes = "\n".join(
        f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{hole / 2:.2f}"/>'
        f'<path d="M{x - 2:.2f} {y:.2f}h4M{x:.2f} {y - 2:.2f}v4"/>'
        for x, y in centers
    )
    text = (
        f"annotate-cloud: {plate.columns} x {plate.rows} holes of {hole:g} mm, rows {row:g} mm apart; "
        "the line is 100 mm"
    )
    view = f"{-MARGIN_MM:g} {-MARGIN_MM:g} {width + 2 * MARGIN_MM:g} {height + 2 * MARGIN_MM:g}"
    size = f'width="{width + 2 * MARGIN_MM:g}mm" height="{height + 2 * MARGIN_MM:g}mm"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="{view}">\n'
        '<g fill="none" stroke="black" stroke-width="0.2">\n'
        f'<rect width="{width:g}" height="{height:g}"/>\n{holes}\n'
        f'<path stroke-width="0.4" d="M0 {height + 8:g}h100m0-2v4m-100 0v-4"/>\n</g>\n'
        f'<text x="0" y="-4" font-size="5" font-family="sans-serif">{text}</text>\n</svg>\n'
    )
