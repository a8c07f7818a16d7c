"""Reports of a comparison of two sides: `info` puts it into words, the others write it.

`info` ranks the results, worst first; `words` formats numbers; `terminal`, `markdown`, `junit`, `document` (JSON) and `page`
(HTML) write, each with a `render`.
"""
