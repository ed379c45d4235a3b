"""One step done, in this process."""

from jaxscan.project.work.orders import Order, do_step, order_of
