"""MAVLink to records: live links (``mavlink_links``, ``mavlink_session``), telemetry logs
(``mavlink_tlog``) and DataFlash logs (``mavlink_dataflash``). ``mavlink_records`` is the door.
"""
