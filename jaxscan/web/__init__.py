"""Pages served to a browser, behind one gate: who may come in, what may be asked for, and where else it may lead."""

from jaxscan.web.address import Address, open_address
from jaxscan.web.gate import Gate
from jaxscan.web.pages import PAGE_POLICY, Resource, resource_routes
from jaxscan.web.proxy import proxy_routes
from jaxscan.web.server import Server
