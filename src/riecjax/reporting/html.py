"""One self-contained HTML page of a result."""

import base64
import json
from pathlib import Path

import jinja2

from riecjax.reporting.output import Document

TEMPLATE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
  body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto;
         padding: 0 1rem; color: #1a1a1a; background: #fff; }
  pre { overflow-x: auto; font-size: 13px; line-height: 1.35; background: #f6f6f4; padding: 1rem; }
  figure { margin: 2rem 0; }
  img { max-width: 100%; height: auto; }
  .warning { border-left: 4px solid #b45309; padding: .2rem 1rem; background: #fffbeb; }
  details { margin: 2rem 0; }
</style>
</head>
<body>
<h1>{{ title }}</h1>
<pre>{{ text }}</pre>
{% for warning in warnings %}
<p class="warning"><strong>{{ warning.code }}</strong>: {{ warning.message }}</p>
{% endfor %}
{% for figure in figures %}
<figure><img alt="{{ figure.name }}" src="data:image/png;base64,{{ figure.data }}"></figure>
{% endfor %}
<details><summary>Where these numbers come from</summary><pre>{{ provenance }}</pre></details>
</body>
</html>
"""


def report_page(title: str, document: Document, figures: list[Path], text: str) -> str:
    """The page: warnings, tables as printed on the terminal, figures, provenance."""
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(TEMPLATE).render(
        title=title,
        warnings=document.get("warnings", []),
        text=text,
        figures=[
            {"name": path.stem, "data": base64.b64encode(path.read_bytes()).decode()}
            for path in figures
        ],
        provenance=json.dumps(document.get("provenance", {}), indent=2),
    )
