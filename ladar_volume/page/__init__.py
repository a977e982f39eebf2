"""The page in the field: what a survey is at while it runs, for a phone or a tablet (``feed`` what
it shows, ``field_page`` how it is served).
"""
