// The pages of an arena that the view may show, four work groups each. page_table.hpp numbers them.
struct Page {
  uint number;  // among all that are kept, in the order of slots
  uint page;    // in the arena
  uint group;   // of all its splats, by index in `groups`
  uint level;   // of its nodes, and 256 * that of the cells around them; kNone for a page of slots
};
layout(std430) readonly buffer Pages { Page pages[]; };

uniform uint first_entry;  // of the arena, in `pages`

Page groupPage() { return pages[first_entry + workGroup() / 4u]; }

// The index in the page of this invocation's slot.
uint slotInPage() { return 256u * (workGroup() % 4u) + gl_LocalInvocationIndex; }
