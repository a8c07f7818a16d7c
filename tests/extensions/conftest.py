from command_fixtures import call, runs
from page_fixtures import chromium, new_tab, pages, read_with, reader, show, tab

__all__ = ["call", "chromium", "new_tab", "pages", "read_with", "reader", "runs", "show", "tab"]
