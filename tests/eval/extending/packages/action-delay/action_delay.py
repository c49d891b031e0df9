from nw_eval import Axis


def later(setup, steps):
    control = setup.card.control
    delayed = control.model_copy(update={"delay_steps": control.delay_steps + round(steps)})
    return setup.replaced(card=setup.card.model_copy(update={"control": delayed}))


AXIS = Axis(
    name="action_delay",
    description="Control steps of 0.02 s by which every action comes later.",
    neutral=0.0,
    low=0.0,
    high=5.0,
    step=1.0,
    change=later,
)
