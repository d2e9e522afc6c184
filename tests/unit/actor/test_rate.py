from appl_dist._native import Rate


def test_cycles_lie_on_a_grid() -> None:
    rate = Rate(50, 7)
    starts = []
    for _ in range(4):
        starts.append(rate.due_ms)
        rate.finish(rate.due_ms + 3)
    assert starts == [7, 57, 107, 157]


def test_after_an_overrun_the_next_cycle_starts_at_once_and_the_grid_stays() -> None:
    rate = Rate(50, 0)
    rate.finish(60)  # 10 ms late
    assert rate.due_ms == 60
    rate.finish(61)
    assert rate.due_ms == 100


def test_more_than_a_period_late_starts_a_new_grid() -> None:
    rate = Rate(50, 0)
    rate.finish(120)  # ros::Rate resets when it is a whole cycle behind
    assert rate.due_ms == 120
    rate.finish(125)
    assert rate.due_ms == 170


def test_waiting_keeps_the_grid() -> None:
    rate = Rate(50, 0)
    rate.wait(12)
    assert rate.due_ms == 12
    rate.finish(13)
    assert rate.due_ms == 50
