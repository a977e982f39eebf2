"""What the model of a survey does not know: places that were not seen, bodies that are cut, ground
that is no plane, passes that disagree. Each ends in a line of the budget or in a doubt.

``gaps`` finds and bridges what was not seen inside the outline, ``completeness`` looks at the edges
of a body, ``base_readings`` at its ground, ``pass_agreement`` at the residuals of the patches.
``field_verdict`` puts them together; ``findings`` keeps what the slow ones found.
"""
