"""What one job needs by itself: its recording, analysis, report and command in one package, offered through `base.extension`."""
