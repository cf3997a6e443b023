"""The report in a real browser: pictures are there, nothing is asked of the net, it fits."""

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='pictures need matplotlib')

import report_browser
from audit_samples import departure, drawn, record, sample_plan
from matplotlib.image import imread

from ambush_planner.tools import report

pytestmark = pytest.mark.skipif(
    report_browser.BINARY is None, reason='no Chromium here; on Debian: apt install chromium'
)


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp('page')
    a_plan = sample_plan()
    record(folder / 'in', [departure(a_plan, route, k + 1)
                           for k, route in enumerate(drawn(a_plan, 12))])
    assert report.main([str(folder / 'in'), '-o', str(folder / 'out')]) == 0
    return folder / 'out' / 'report.html'


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    with report_browser.Browser(tmp_path_factory.mktemp('profile')) as browser:
        yield browser


@pytest.mark.parametrize('width', [390, 1100], ids=['phone', 'desk'])
def test_the_page_shows_its_pictures_and_stays_at_home(browser, page, tmp_path, width):
    browser.load(page, width)
    pictures = browser.evaluate(
        '[...document.images].map(i => [i.complete, i.naturalWidth, '
        'i.getBoundingClientRect().width, i.alt.length])'
    )
    assert len(pictures) == 3
    for complete, natural, shown, described in pictures:
        assert complete and natural > 500 and 300 < shown <= width and described > 10
    # Nothing but the page itself and what it holds.
    asked = [url for url in browser.requests() if not url.startswith('data:')]
    assert asked == [page.resolve().as_uri()]
    assert browser.complaints() == []
    # It does not scroll sideways, and has much to show.
    assert browser.evaluate('document.documentElement.scrollWidth') <= width
    browser.screenshot(tmp_path / 'page.png')
    image = imread(tmp_path / 'page.png')
    assert image.shape[1] == width and image.shape[0] > 2000
    assert np.std(image[..., :3]) > 0.05
    bluish = (image[..., 2] - image[..., 0] > 0.3).mean()
    reddish = (image[..., 0] - image[..., 2] > 0.3).mean()
    assert bluish > 0.004 and reddish > 0.008


def test_what_leaves_a_page_would_be_noticed(browser, tmp_path):
    """The check above can fail: a page that asks for a picture and runs a script is caught."""
    tell_tale = tmp_path / 'tell_tale.html'
    tell_tale.write_text('<img src="http://elsewhere.invalid/pixel.png"><script>x = 7</script>')
    browser.load(tell_tale, 800)
    assert 'http://elsewhere.invalid/pixel.png' in browser.requests()
    assert browser.evaluate('x') == 7


def test_the_policy_stops_scripts_and_pictures_from_elsewhere(browser, page, tmp_path):
    """If anything hostile came through all the same, the page's own policy would hold."""
    hostile = '<img src="http://elsewhere.invalid/pixel.png"><script>x = 7</script></body>'
    changed = tmp_path / 'changed.html'
    changed.write_text(page.read_text().replace('</body>', hostile))
    browser.load(changed, 800)
    assert browser.evaluate('typeof x') == 'undefined'
    assert browser.evaluate('document.images[3].naturalWidth') == 0
    assert len(browser.complaints()) >= 2
