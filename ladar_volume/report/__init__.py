"""Results as pictures and pages: PNG figures, and a report as one HTML page with its JSON twin.

Public
- ``survey_report.write_survey_report``: the report of a replayed survey.
- ``cloud_report.write_cloud_report``: the report of a volume from point cloud or mesh files.
- ``figure.save``: the picture of a volume; ``change.save``: of a change between two surveys.

``report_page`` makes the page and the twin, ``plates`` its maps and sections as SVG, ``scene`` the
surface that the maps show.
"""
