"""Self-contained HTML page: template, filters, styles, scripts."""
