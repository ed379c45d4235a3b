"""Pages served to a browser, behind one gate that checks who may come in and what they may request."""

from jaxscan.web.address import Address, open_address
from jaxscan.web.gate import Gate
from jaxscan.web.opening import in_browser
from jaxscan.web.pages import PAGE_POLICY, page_routes
from jaxscan.web.server import Server
