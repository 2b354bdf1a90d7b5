"""A self-contained HTML page: text, tables, pictures and clips, with everything embedded."""

import base64
import html
import json
from collections.abc import Sequence

import cv2
from jaxtyping import UInt8
from numpy import ndarray

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1, h2 { line-height: 1.2 } h2 { margin-top: 2.2rem; border-bottom: 1px solid #ddd }
img, video { max-width: 100%; image-rendering: pixelated } figure { margin: 1rem 0 }
figcaption { color: #666; font-size: 13px } table { border-collapse: collapse }
pre { font-size: 12px; overflow-x: auto }
th, td { padding: .25rem .8rem; border-bottom: 1px solid #ddd; text-align: right }
th:first-child, td:first-child { text-align: left }
.key { display: inline-block; width: .8em; height: .8em; margin: 0 .3em 0 .9em }
"""

_SLIDES = """
<img alt="frame"><div><button>play</button>
<input type="range" min="0" value="0" style="width:70%"></div><figcaption></figcaption>
"""
_PLAYER = """(content) => {
  const figure = document.currentScript.parentElement, find = (name) => figure.querySelector(name);
  const picture = find("img"), slider = find("input"), button = find("button");
  let timer = null;
  const show = (i) => {
    slider.value = i; picture.src = content.urls[i]; find("figcaption").textContent = content.captions[i];
  };
  slider.max = content.urls.length - 1;
  slider.oninput = () => show(Number(slider.value));
  button.onclick = () => {
    button.textContent = timer ? "play" : "pause";
    if (timer) { clearInterval(timer); timer = null; return; }
    timer = setInterval(() => show((Number(slider.value) + 1) % content.urls.length), 150);
  };
  show(0);
}"""


class Page:
    """Collects the parts of a page.

    Args:
        title: of the page.
    """

    def __init__(self, title: str):
        self._title = html.escape(title)
        self._parts = [f"<h1>{self._title}</h1>"]

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def preformatted(self, text: str) -> None:
        """Add lines of fixed-width text."""
        self._parts.append(f"<pre>{html.escape(text)}</pre>")

    def legend(self, names: Sequence[str], colours: UInt8[ndarray, "C 3"]) -> None:
        """Add a line that says which colour is which class."""
        keys = zip(names, colours.tolist(), strict=True)
        spans = [f'<span class="key" style="background:rgb{tuple(c)}"></span>{html.escape(n)}' for n, c in keys]
        self._parts.append(f"<p>{''.join(spans)}</p>")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table."""
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
        self._parts.append(f"<table><tr>{head}</tr>{body}</table>")

    def image(self, picture: UInt8[ndarray, "H W 3"] | bytes, caption: str) -> None:
        """Add an RGB picture, or the bytes of a PNG file."""
        content = picture if isinstance(picture, bytes) else cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
        self._figure(f'<img alt="{html.escape(caption)}" src="{_data_url("image/png", content)}">', caption)

    def clip(self, mp4: bytes, caption: str) -> None:
        """Add a clip that plays in a loop."""
        url = _data_url("video/mp4", mp4)
        self._figure(f'<video src="{url}" controls autoplay loop muted playsinline></video>', caption)

    def slides(self, pictures: Sequence[UInt8[ndarray, "_ _ 3"]], captions: Sequence[str]) -> None:
        """Add RGB pictures one at a time, with a slider and a play button."""
        encoded = [cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1] for picture in pictures]
        content = {"urls": [_data_url("image/jpeg", e.tobytes()) for e in encoded], "captions": list(captions)}
        data = json.dumps(content).replace("</", "<\\/")
        self._parts.append(f'<figure class="slides">{_SLIDES}<script>({_PLAYER})({data})</script></figure>')

    def frame(self, document: str, height: int) -> None:
        """Add another self-contained page inside this one, as high as ``height`` [pixels]."""
        style = f"width:100%;height:{height}px;border:1px solid #ddd"
        self._parts.append(f'<iframe style="{style}" srcdoc="{html.escape(document)}"></iframe>')

    def render(self) -> str:
        """Return the page."""
        head = f'<meta charset="utf-8"><title>{self._title}</title><style>{_STYLE}</style>'
        body = "\n".join(self._parts)
        return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n</body></html>\n'

    def _figure(self, element: str, caption: str) -> None:
        self._parts.append(f"<figure>{element}<figcaption>{html.escape(caption)}</figcaption></figure>")


def _data_url(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
