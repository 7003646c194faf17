"""The interactive map of a page: what the scripts in ``templates/view`` show, as JSON inside the page.

Leaflet moves and zooms the map. Its script comes from the package ``xstatic-leaflet`` and is copied into the page.
"""
