"""A report as one HTML file: mesh, levels, runs, box plots, tables; it needs no network and no library."""

from agglo_core.draw.webpage.page import check_page, write_page

__all__ = ["check_page", "write_page"]
