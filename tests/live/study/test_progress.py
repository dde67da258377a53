"""
The page is a fold over the events. Oracle: what happened, written out, and the order in which it
may not matter.
"""

from hypothesis import given, strategies as st

from trustlab.live.study.progress import progress_of

PAGES = 8


def done(page, **facts):
    return {"kind": "page", "page": page, **facts}


def test_a_restarted_drive_comes_back_and_what_follows_stays_done():
    events = [done(0), done(1), done(2), {"kind": "restart", "page": 1}]
    assert progress_of(events).page(PAGES) == 1
    assert progress_of(events).attempt(1) == 1
    assert progress_of([*events, done(1)]).page(PAGES) == 3
    assert progress_of([*events, {"kind": "restart", "page": 1}]).attempt(1) == 2


@given(st.lists(st.integers(0, PAGES - 2), max_size=12), st.randoms())
def test_the_same_pages_done_lead_to_the_same_page_in_any_order_and_number(pages, random):
    events = [done(page) for page in pages]
    shuffled = [*events, *events]
    random.shuffle(shuffled)
    assert progress_of(shuffled).page(PAGES) == progress_of(events).page(PAGES)
    assert progress_of(events).page(PAGES) == min(set(range(PAGES)) - set(pages))
