"""One step done, in this process."""

from jaxscan.project.work.orders import Order, begun_row, do_step, failed_row, order_of
