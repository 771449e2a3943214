"""Looks at the monitor's page as a person would: it moves, it is read by keyboard, it is quiet, it tells a miss
and the stage to blame; in light, dark and on a phone.

Usage: check.py URL FOLDER. Pictures go to FOLDER. Exit code 0 passed, 1 failed, 77 no browser.
"""

import pathlib
import shutil
import sys

try:
    from playwright.sync_api import Error, expect, sync_playwright
except ImportError:
    print("SKIPPED: no playwright: pip install playwright")
    sys.exit(77)

SIZES = {
    "light": ("light", 1400, 1250),
    "dark": ("dark", 1400, 1250),
    "phone": ("dark", 390, 844),
}
MOVES_MS = 15_000


def browser_of(playwright):
    """Playwright's own Chromium, else the system's."""
    try:
        return playwright.chromium.launch()
    except Error:
        path = shutil.which("chromium") or shutil.which("google-chrome")
        if path is None:
            print("SKIPPED: no browser: apt-get install chromium")
            sys.exit(77)
        return playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])


def until(page, script, holds, within_ms=MOVES_MS):
    """Waits until `holds` of what `script` gives. From here: the page's own policy lets no waiting script be evaluated in it."""
    for _ in range(within_ms // 100):
        if holds(page.evaluate(script)):
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"not within {within_ms} ms: {script}")


def moved(page, script):
    """Waits until what `script` gives is another value than now."""
    before = page.evaluate(script)
    until(page, script, lambda now: now != before)


def canvas_sum(page):
    """How many pixels of the grid have each colour."""
    return page.evaluate(
        """() => { const c = document.getElementById('grid'); const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
        const seen = new Set(); for (let i = 0; i < d.length; i += 40) seen.add(`${d[i]},${d[i+1]},${d[i+2]}`); return [...seen].sort().join(' '); }"""
    )


def check_alive(page):
    expect(page.locator("#link")).to_have_text("live", timeout=MOVES_MS)
    expect(page.locator("#picture")).to_be_visible(timeout=MOVES_MS)
    until(page, "document.getElementById('picture').naturalWidth", lambda width: width >= 320)
    moved(page, "document.getElementById('picture').src")
    moved(page, "document.getElementById('grid').toDataURL()")
    moved(page, "document.getElementById('stages').innerHTML")
    moved(page, "document.getElementById('percentiles').textContent")
    assert page.locator("#latency rect.bar").count() >= 1, "the histogram has no bar"
    assert page.locator("#stages rect").count() >= 8, "no stage is drawn"


# Key frames that were missed because of the stage that the demo makes slow.
SLOW_MISSES = "[...document.querySelectorAll('#misses tr')].filter(row => row.cells[4].textContent === 'crf').length"


def check_miss_appears(page, before):
    assert before == 0, "the stage was slow before the page was looked at"
    until(page, SLOW_MISSES, lambda misses: misses > 0, 30_000)
    expect(page.locator("#blames")).to_contain_text("crf")


def check_keyboard(page):
    before = canvas_sum(page)
    page.locator("input[value=occupancy]").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("input[value=reason]")).to_be_checked()
    expect(page.locator("#legend")).to_contain_text("seen, not road")
    assert canvas_sum(page) != before, "the colours did not change"
    page.keyboard.press("ArrowLeft")
    page.locator("#pause").focus()
    page.keyboard.press("Enter")
    expect(page.locator("#pause")).to_have_attribute("aria-pressed", "true")
    still = page.locator("#percentiles").text_content()
    page.wait_for_timeout(1_500)
    assert page.locator("#percentiles").text_content() == still, "a paused page moved"
    page.keyboard.press("Enter")
    expect(page.locator("#link")).to_have_text("live", timeout=MOVES_MS)


def check_names(page):
    nameless = page.evaluate(
        """() => [...document.querySelectorAll('img, canvas, svg, button, input, section, [role=img]')]
        .filter(e => !(e.getAttribute('aria-label') || e.alt || e.labels?.length || e.textContent.trim() || e.getAttribute('aria-labelledby')))
        .map(e => e.outerHTML.slice(0, 80))"""
    )
    assert not nameless, f"without an accessible name: {nameless}"


def check_fits(page):
    wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0, f"the page is {wide} px wider than the window"


def look(browser, url, folder, name):
    scheme, width, height = SIZES[name]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    told, outside = [], []
    page.on("console", lambda message: told.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: told.append(str(error)))
    page.on("request", lambda request: None if request.url.startswith((url, "data:")) else outside.append(request.url))
    page.goto(url)
    check_alive(page)
    slow_before = page.evaluate(SLOW_MISSES)
    check_names(page)
    check_fits(page)
    if name == "light":
        check_keyboard(page)
        check_miss_appears(page, slow_before)
    page.screenshot(path=str(folder / f"{name}.png"), full_page=True)
    context.close()
    assert not told, f"the browser complains: {told}"
    assert not outside, f"asked elsewhere: {outside}"


def main():
    url, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = browser_of(playwright)
        for name in SIZES:
            look(browser, url, folder, name)
            print(f"{name}: the page moves and is whole")
        browser.close()


main()
