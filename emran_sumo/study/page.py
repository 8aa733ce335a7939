"""The frame of a study's page; for the screen and for A4."""

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  color: #1a1a1a; background: #fff; max-width: 62rem; margin: 2.5rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 1rem; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .75rem; border-bottom: 1px solid #ccc; padding-bottom: .25rem; }
h3 { font-size: 1.05rem; margin: 2rem 0 .5rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1rem; font-size: .9rem; margin: 0 0 1.5rem; }
dt { color: #595959; } dd { margin: 0; overflow-wrap: anywhere; }
figure { margin: 0; break-inside: avoid; }
figure img { width: 100%; height: auto; display: block; }
figcaption, caption { font-size: .85rem; color: #444; text-align: left; margin: .25rem 0 .75rem; caption-side: top; }
table { border-collapse: collapse; width: 100%; font-size: .82rem; line-height: 1.35; margin: 1.25rem 0;
  font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem .3rem 0; border-bottom: 1px solid #e2e2e2; }
thead th { border-bottom: 1.5px solid #444; } tbody th { font-weight: 500; }
tr { break-inside: avoid; } small { color: #595959; font-size: .92em; }
code { font: .92em/1.4 ui-monospace, "SF Mono", Menlo, Consolas, monospace; overflow-wrap: anywhere; }
.worst td:last-child { min-width: 16rem; }
a { color: #0057a3; }
@page { size: A4; margin: 16mm 15mm; }
@media print {
  body { font-size: 10pt; max-width: none; margin: 0; padding: 0; }
  h2, h3, caption { break-after: avoid; } thead { display: table-header-group; } a { color: inherit; }
}
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>{title}</h1>
<dl>{facts}</dl>
{answer}
{sections}
<h2>Worst runs</h2>
{worst}
{failures}
</body>
</html>
"""
