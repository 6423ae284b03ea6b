"""Readings for others: the page, and other programs.

| file | holds |
|---|---|
| `server` | LiveServer: the readings that the page shows |
| `web`, `page/` | the page's files, and who may ask for them |
| `outlet` | contacts as CSV, whole readings by a socket |
"""

#: Inside of live its files are imported one by one: none of their names is public.
__all__: list[str] = []
