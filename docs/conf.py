"""Makes the site of the documentation: `make docs`, into out/docs."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS))

from interfaces import rendered  # noqa: E402

project = "ROSplat"
author = "the authors of ROSplat"
html_title = "ROSplat"
html_theme = "furo"
html_show_copyright = False
exclude_patterns = ["results"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "breathe"]
myst_heading_anchors = 4
myst_enable_extensions = ["html_image"]
default_role = "literal"

# Without ROS 2, pages of modules that use it are made all the same.
ROS = (
    "rclpy", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "rcl_interfaces",
    "rosplat_msgs", "sensor_msgs", "std_msgs",
)  # fmt: skip
autodoc_mock_imports = [] if find_spec("rclpy") else list(ROS)
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 80

breathe_default_project = "rosplat"
suppress_warnings = ["duplicate_declaration.cpp"]  # of the namespace, by each header
cpp_maximum_signature_line_length = 80
cpp_id_attributes = ["ROSPLAT_VECTORISED"]


def read_headers(app: Sphinx) -> None:
    """Has Doxygen read the public headers."""
    folder = Path(app.doctreedir).parent / "doxygen"
    folder.mkdir(parents=True, exist_ok=True)
    settings = (DOCS / "Doxyfile").read_text() + f"OUTPUT_DIRECTORY = {folder}\n"
    subprocess.run(["doxygen", "-"], input=settings, text=True, cwd=ROOT, check=True)
    app.config.breathe_projects = {"rosplat": str(folder / "xml")}


# What stands elsewhere in the repository and has a page here.
PAGES = {"README.md": "/index.md", "rosplat_msgs/doc/quantised.md": "/api/quantised.md",
         "rosplat_msgs/doc/packed.md": "/api/packed.md",
         "rosplat_msgs": "/api/messages.md"}  # fmt: skip


def complete(app: Sphinx, page: str, source: list[str]) -> None:
    """Puts what stands elsewhere onto pages, and has links lead to it there."""
    text = source[0]
    if page == "index":
        readme = (ROOT / "README.md").read_text()
        readme = re.sub(r"(\]\(|src=\")(?!https?:|#|mailto:)", r"\1../", readme)
        text = readme.replace("../docs/", "") + "\n" + text
    elif page == "api/messages":
        files = sorted((ROOT / "rosplat_msgs").glob("[ms][sr][gv]/*"))
        text += "\n".join(rendered(path) for path in files)
    for path, there in PAGES.items():
        text = re.sub(rf"\]\((\.\./)+{path}(?=[)#])", f"]({there}", text)
    text = re.sub(
        r"\]\((\.\./)+rosplat_msgs/(msg|srv)/(\w+)\.\2",
        lambda file: f"](/api/messages.md#{file[3].lower()}",
        text,
    )
    source[0] = re.sub(r"^{{ (\w+) }}$", _headers, text, flags=re.MULTILINE)


def _headers(room: re.Match[str]) -> str:
    """Directives for a header, or for all of a room of the engine or of a package."""
    paths = [
        path for path in ROOT.glob("*/include/**/*.hpp") if room[1] in (path.stem, path.parent.name)
    ]
    names = sorted(path.name for path in paths)
    shown = [f".. rubric:: {name}\n\n.. doxygenfile:: {name}\n" for name in names]
    return "\n".join(["```{eval-rst}", *shown, "```"])


def setup(app: Sphinx) -> None:
    app.connect("builder-inited", read_headers)
    app.connect("source-read", complete)
