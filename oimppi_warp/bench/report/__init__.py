"""The report of a result set: tables, figures, an HTML page and Markdown."""
