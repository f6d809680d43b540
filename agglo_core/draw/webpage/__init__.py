"""Report as one HTML file without external files: mesh, levels, runs, box plots, tables."""

from agglo_core.draw.webpage.page import check_page, write_page

__all__ = ["check_page", "write_page"]
