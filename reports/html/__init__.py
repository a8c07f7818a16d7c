"""The page that stands alone: template, filters, styles, scripts."""
