"""From motion-capture markers to the motion of body, hands, face and object (paper 3.2, S.8).

Recordings come from `c3d` and `tables`; a `layout` says where the markers sit; `stage_one` finds out where they really
sat and `stage_two` what the body did, both over the `attachment` of markers to the skin, the residual `terms` and the
`solver`; `rigid` follows objects.
"""
