! Optimize: -O1
!> Objects by handle, a number that is never reused. An invalid number is an error, not a crash.
!! Threads may use different objects concurrently.
module viscovib_handles
  use viscovib_kinds, only: i8
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_task, only: task_link, task_type
  implicit none
  private

  public :: add_object, find_objects, remove_object, release

  !> Number of bits of a handle for the slot of its object.
  integer, parameter :: place_bits = 32

  type :: slot_type
    type(task_type), pointer :: object => null()
    integer(i8) :: generation = 0
  end type slot_type

  type(slot_type), allocatable :: slots(:)
  integer :: n_slots = 0
  !> Stack of free slots.
  integer, allocatable :: free(:)
  integer :: n_free = 0

  interface
    subroutine lock() bind(c, name='viscovib_lock_handles')
    end subroutine lock
    subroutine unlock() bind(c, name='viscovib_unlock_handles')
    end subroutine unlock
  end interface

contains

  !> Store an object, which the handle owns from now on.
  integer(i8) function add_object(object) result(handle)
    type(task_type), pointer, intent(in) :: object
    type(slot_type), allocatable :: more(:)
    integer, allocatable :: more_free(:)
    integer :: place

    call lock()
    if (.not. allocated(slots)) allocate (slots(64), free(64))
    if (n_free > 0) then
      place = free(n_free)
      n_free = n_free - 1
    else
      if (n_slots == size(slots)) then
        allocate (more(2*n_slots), more_free(2*n_slots))
        more(:n_slots) = slots
        more_free(:n_free) = free(:n_free)
        call move_alloc(more, slots)
        call move_alloc(more_free, free)
      end if
      n_slots = n_slots + 1
      place = n_slots
    end if
    slots(place)%object => object
    slots(place)%generation = slots(place)%generation + 1
    handle = ior(shiftl(slots(place)%generation, place_bits), int(place, i8))
    call unlock()
  end function add_object

  !> Objects of handles, with their numbers of users increased. Fails if a handle is invalid.
  subroutine find_objects(handles, links, status)
    integer(i8), intent(in) :: handles(:)
    type(task_link), intent(out) :: links(:)
    type(status_type), intent(out) :: status
    integer :: i, place

    call set_ok(status)
    call lock()
    do i = 1, size(handles)
      place = place_of(handles(i))
      if (place == 0) exit
      links(i)%to => slots(place)%object
    end do
    if (i > size(handles)) then
      do i = 1, size(handles)
        links(i)%to%users = links(i)%to%users + 1
      end do
    else
      call fail(status, status_input_error, 'handle', 'handle: belongs to no object, or to one ' &
                //'that was freed')
    end if
    call unlock()
  end subroutine find_objects

  !> Remove the handle of an object. The object is deleted when no other object depends on it.
  subroutine remove_object(handle, status)
    integer(i8), intent(in) :: handle
    type(status_type), intent(out) :: status
    type(task_link) :: link
    integer :: place

    call set_ok(status)
    call lock()
    place = place_of(handle)
    if (place > 0) then
      link%to => slots(place)%object
      nullify (slots(place)%object)
      n_free = n_free + 1
      free(n_free) = place
    end if
    call unlock()
    if (place > 0) then
      call release(link)
    else
      call fail(status, status_input_error, 'handle', 'handle: belongs to no object, or to one ' &
                //'that was freed')
    end if
  end subroutine remove_object

  !> Decrease the number of users of an object, and delete it if there are none.
  recursive subroutine release(link)
    type(task_link), intent(inout) :: link
    integer :: i, users

    call lock()
    link%to%users = link%to%users - 1
    users = link%to%users
    call unlock()
    if (users > 0) return
    if (allocated(link%to%parents)) then
      do i = 1, size(link%to%parents)
        call release(link%to%parents(i))
      end do
    end if
    deallocate (link%to)
  end subroutine release

  !> Slot of a handle; 0: invalid.
  integer function place_of(handle) result(place)
    integer(i8), intent(in) :: handle
    integer(i8) :: low
    place = 0
    low = iand(handle, shiftl(1_i8, place_bits) - 1_i8)
    if (low < 1 .or. low > n_slots) return
    if (.not. associated(slots(low)%object)) return
    if (slots(low)%generation == shiftr(handle, place_bits)) place = int(low)
  end function place_of

end module viscovib_handles
