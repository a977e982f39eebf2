"""What a node knows of its own state and of its inputs, and how it reports it.

``health`` (rates, ages, backlog), ``loss_shares`` (what was lost lately), ``sensor_checks`` and
``clock_words`` (set-up and clocks of the sensors), ``defect_reports``, ``others`` (nodes of the
same namespace), ``wanted_topics`` (what the log takes).
"""
