"""Light and dark theme: named colours, and Qt's style made of them."""

from dataclasses import dataclass

from PySide6.QtCore import Qt
from PySide6.QtGui import QColor, QFontInfo, QGuiApplication, QPalette
from PySide6.QtWidgets import QApplication

from annotate.scheme.scheme import BACKGROUND, UNDEFINED, UNDEFINED_RGB, Scheme

Rgb = tuple[int, int, int]
USUAL_PX = 13  # size of the desktop's font for which sizes are given, in logical pixels
FONT_PX = (10, 26)  # least and greatest size of the desktop's font that is followed


def scaled(px: float) -> int:
    """Return a size in logical pixels, scaled by the desktop's font size."""
    font_px = QFontInfo(QGuiApplication.font()).pixelSize()
    return round(px * min(max(font_px, FONT_PX[0]), FONT_PX[1]) / USUAL_PX)


@dataclass(frozen=True)
class Theme:
    """Colours as "#rrggbb".

    ground: behind the cloud. surface: panels. raised: buttons. line: borders. text, quiet: text and secondary
    text. accent: chosen items. good, warn, bad: states.
    """

    ground: str
    surface: str
    raised: str
    line: str
    text: str
    quiet: str
    accent: str
    on_accent: str
    good: str
    warn: str
    bad: str

    @property
    def ground_rgb(self) -> Rgb:
        """Return the colour behind the cloud as numbers."""
        color = QColor(self.ground)
        return color.red(), color.green(), color.blue()


DARK = Theme(
    *("#14161b", "#1c1f26", "#272b34", "#353a46", "#e8eaf0", "#98a0b0"),
    *("#5b9dff", "#08101e", "#4cc38a", "#f5b73d", "#f2706b"),
)
LIGHT = Theme(
    *("#eef0f4", "#ffffff", "#f0f2f6", "#d4d8e0", "#1b1f27", "#5c6472"),
    *("#1f66d6", "#ffffff", "#18794e", "#9a5b00", "#c62f2f"),
)


def theme_of(name: str) -> Theme:
    """Return the theme of a setting: "light", "dark", or "system"."""
    if name == "system":
        scheme = QGuiApplication.styleHints().colorScheme()
        return LIGHT if scheme == Qt.ColorScheme.Light else DARK
    return LIGHT if name == "light" else DARK


def part_color(scheme: Scheme, part: int, theme: Theme) -> QColor:
    """Return the colour of a part in lists; the background has the grey of the room."""
    if part == UNDEFINED:
        return QColor(*UNDEFINED_RGB)
    return QColor(theme.line) if part == BACKGROUND else QColor(*scheme.by_id[part].rgb)


def style_app(theme: Theme) -> None:
    """Apply the theme's colours to all widgets."""
    app = QApplication.instance()
    assert isinstance(app, QApplication)
    app.setPalette(qt_palette(theme))
    sheet = style_sheet(theme)
    if app.styleSheet() != sheet:
        app.setStyleSheet(sheet)


def qt_palette(theme: Theme) -> QPalette:
    """Return Qt's palette, for widgets outside the style sheet."""
    palette = QPalette()
    for color, roles in (
        (theme.surface, ("Window", "Base")),
        (theme.raised, ("AlternateBase", "Button", "ToolTipBase")),
        (theme.text, ("WindowText", "Text", "ButtonText", "ToolTipText")),
        (theme.quiet, ("PlaceholderText",)),
        (theme.accent, ("Highlight",)),
        (theme.on_accent, ("HighlightedText",)),
    ):
        for role in roles:
            palette.setColor(QPalette.ColorRole[role], QColor(color))
    return palette


def style_sheet(theme: Theme) -> str:
    """Return the style sheet of all widgets."""
    t = theme
    body, small, title = scaled(13), scaled(11), scaled(14)
    return f"""
    QWidget {{ color: {t.text}; font-size: {body}px; }}
    QMainWindow, QDialog, #panel {{ background: {t.surface}; }}
    QFrame#line {{ background: {t.line}; max-height: 1px; min-height: 1px; border: none; }}
    QLabel#title {{ font-size: {title}px; font-weight: 600; }}
    QLabel#quiet, QLabel#caption {{ color: {t.quiet}; }}
    QLabel#caption {{ font-size: {small}px; font-weight: 600; letter-spacing: 1px; }}
    QLabel#key {{ background: {t.raised}; border: 1px solid {t.line}; border-radius: 4px;
        padding: 0px 5px; font-family: monospace; font-size: {scaled(12)}px; }}
    QLabel#badge {{ border-radius: 9px; padding: 2px 10px; font-weight: 600; }}
    QMenuBar, QMenu {{ background: {t.surface}; }}
    QMenuBar::item {{ background: transparent; padding: 5px 7px; border-radius: 5px; }}
    QMenu {{ border: 1px solid {t.line}; padding: 4px; }}
    QMenu::item {{ padding: 4px 22px; border-radius: 4px; }}
    QMenuBar::item:selected, QMenu::item:selected {{ background: {t.accent}; color: {t.on_accent}; }}
    QMenu::item:disabled {{ color: {t.quiet}; background: transparent; }}
    QMenu::separator {{ background: {t.line}; height: 1px; margin: 4px 8px; }}
    QToolButton, QPushButton {{ background: {t.raised}; border: 1px solid {t.line}; border-radius: 6px;
        padding: 3px 8px; }}
    QToolButton::menu-indicator {{ image: none; }}
    QToolButton:hover, QPushButton:hover {{ border-color: {t.accent}; }}
    QToolButton:checked, QPushButton:default {{ background: {t.accent}; color: {t.on_accent};
        border-color: {t.accent}; }}
    QToolButton:disabled, QPushButton:disabled {{ color: {t.quiet}; background: {t.surface}; }}
    QLineEdit {{ background: {t.raised}; border: 1px solid {t.line}; border-radius: 6px; padding: 3px 7px; }}
    QLineEdit:focus {{ border-color: {t.accent}; }}
    QProgressBar {{ background: {t.raised}; border: none; border-radius: 3px; }}
    QProgressBar::chunk {{ background: {t.good}; border-radius: 3px; }}
    QListView, QScrollArea {{ background: {t.surface}; border: none; outline: none; }}
    QScrollBar:horizontal {{ background: {t.surface}; height: 8px; }}
    QScrollBar:vertical {{ background: {t.surface}; width: 8px; }}
    QScrollBar::handle {{ background: {t.line}; border-radius: 4px; min-width: 32px; min-height: 32px; }}
    QScrollBar::add-line, QScrollBar::sub-line {{ width: 0; height: 0; }}
    QScrollBar::add-page, QScrollBar::sub-page {{ background: transparent; }}
    QSplitter::handle {{ background: {t.line}; border: 2px solid {t.surface}; border-radius: 3px; }}
    QSplitter::handle:hover {{ background: {t.accent}; }}
    QToolTip {{ background: {t.raised}; color: {t.text}; border: 1px solid {t.line}; padding: 4px; }}
    """
