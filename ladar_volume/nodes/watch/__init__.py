"""What a node knows of its own state and of its inputs, and how it reports it.

``health`` (rates, ages, backlog), ``loss_shares`` (what was lost lately), ``sensor_checks`` and
``clock_words`` (set-up and clocks of the sensors), ``defect_reports``, ``upstream_nodes`` and
``fix_step_lines`` (what nodes of a namespace tell each other), ``wanted_topics`` and
``missed_inputs`` (what the log takes and lacks).
"""
