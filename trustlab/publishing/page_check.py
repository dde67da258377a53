"""The check every page passes before it is published: no script, nothing fetched from elsewhere."""

import re
from html.parser import HTMLParser

__all__ = ["page_faults"]

FETCHED = {"src", "srcset", "poster", "data", "background", "xlink:href"}
FORBIDDEN = {"script", "iframe", "object", "embed", "base"}
ELSEWHERE = re.compile(r"@import|url\(\s*['\"]?\s*(?!data:|#)", re.IGNORECASE)


class _Checker(HTMLParser):
    def __init__(self):
        super().__init__()
        self.faults = []
        self.in_style = False

    def handle_starttag(self, tag, attrs):
        self.in_style = tag == "style"
        if tag in FORBIDDEN:
            self.faults.append(f"it has a <{tag}> element")
        for name, value in attrs:
            value = (value or "").strip()
            fetched = name in FETCHED or (name == "href" and tag in ("link", "image", "use", "feimage"))
            if fetched and value and not value.startswith(("data:", "#")):
                self.faults.append(f"its <{tag}> would fetch {value[:80]!r}; embed it")
            if name == "style" and ELSEWHERE.search(value):
                self.faults.append(f"a style of its <{tag}> would fetch something")
            if name.startswith("on"):
                self.faults.append(f"its <{tag}> has a script in {name}")
            if name == "href" and value.lower().startswith("javascript:"):
                self.faults.append(f"its <{tag}> has a script in {name}")
        if tag == "meta" and any(name == "http-equiv" and value == "refresh" for name, value in attrs):
            self.faults.append("it loads another page by itself")

    def handle_endtag(self, tag):
        if tag == "style":
            self.in_style = False

    def handle_data(self, data):
        if self.in_style and ELSEWHERE.search(data):
            self.faults.append("a style sheet in it would fetch something")


def page_faults(page):
    """Return what a page would run or fetch.

    Parameters
    ----------
    page : str
        HTML.

    Returns
    -------
    list of str
        One phrase per fault; empty for a page that is complete in itself.
    """
    checker = _Checker()
    checker.feed(page)
    checker.close()
    return list(dict.fromkeys(checker.faults))
