"""Every inverse problem that ships, gathered on one page."""
