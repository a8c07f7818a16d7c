from page_fixtures import chromium, new_tab, pages, read_with, reader, show, tab

__all__ = ["chromium", "new_tab", "pages", "read_with", "reader", "show", "tab"]
