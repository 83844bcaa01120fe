!> C interface: systems. include/viscovib.h declares and documents the calls.
!!
!! A system is stored as the groups of a scene. Scenes, the driver and C thus share the syntax, the
!! checks and the messages. Numbers are written so that they read back exactly.
module viscovib_c_systems
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_double, c_f_pointer, c_int, &
    c_loc, c_null_ptr, c_ptr, c_size_t
  use viscovib_kinds, only: wp
  use viscovib_growing_text, only: growing_text
  use viscovib_number_text, only: exact
  use viscovib_polynomial, only: max_coordinates
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: fail, one_line, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: c_system, description, text_of, numbers_text, read_call, result_place, system_of

  character(len=*), parameter :: nl = new_line('a')
  !> Prefix of messages of calls, which is removed, since no file is read.
  character(len=*), parameter, public :: call_path = 'call'

  type :: c_system
    !> Groups of the system, one per line.
    character(len=:), allocatable :: text
    integer :: n_coordinates = 0
  end type c_system

  interface
    integer(c_size_t) function c_length(text) bind(c, name='strlen')
      import :: c_ptr, c_size_t
      type(c_ptr), value :: text
    end function c_length

    subroutine keep_message(text, n) bind(c, name='viscovib_keep_message')
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: text(*)
      integer(c_int), value :: n
    end subroutine keep_message
  end interface

contains

  !> Convert a status for C and keep its message.
  integer(c_int) function description(status)
    type(status_type), intent(in) :: status
    character(len=:), allocatable :: text
    integer :: last

    description = int(status%category, c_int)
    if (.not. status%failed()) return
    text = one_line(status%message)
    if (index(text, call_path//':') == 1) then
      text = text(len(call_path) + 2:)
      ! Remove the line number as well.
      last = verify(text, '0123456789')
      if (last > 1) then
        if (text(last:last) == ':') text = text(last + 1:)
      end if
      text = trim(adjustl(text))
    end if
    call keep_message(text, int(len(text), c_int))
  end function description

  !> Convert a C string; NULL gives an empty text.
  function text_of(place) result(text)
    type(c_ptr), intent(in) :: place
    character(len=:), allocatable :: text
    character(kind=c_char), pointer :: letters(:)
    integer :: i, n

    text = ''
    if (.not. c_associated(place)) return
    n = int(c_length(place))
    if (n == 0) return
    call c_f_pointer(place, letters, [n])
    deallocate (text)
    allocate (character(len=n) :: text)
    do i = 1, n
      text(i:i) = letters(i)
    end do
  end function text_of

  !> ' name = ' followed by numbers that read back exactly.
  function numbers_text(name, values) result(text)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: values(:)
    character(len=:), allocatable :: text
    type(growing_text) :: place
    integer :: i

    call place%add(' '//name//' =')
    do i = 1, size(values)
      call place%add(' '//trim(exact(values(i))))
    end do
    text = place%text()//','
  end function numbers_text

  !> System of a handle; fails if there is none.
  subroutine system_of(handle, system, status)
    type(c_ptr), intent(in) :: handle
    type(c_system), pointer, intent(out) :: system
    type(status_type), intent(out) :: status

    call set_ok(status)
    nullify (system)
    if (c_associated(handle)) then
      call c_f_pointer(handle, system)
    else
      call fail(status, status_input_error, 'system', 'system: is NULL, must be made by ' &
                //'viscovib_system_new or viscovib_system_read')
    end if
  end subroutine system_of

  !> Pointer to the caller's handle, set to NULL; fails if `place` is NULL.
  subroutine result_place(place, handle, status)
    type(c_ptr), intent(in) :: place
    type(c_ptr), pointer, intent(out) :: handle
    type(status_type), intent(out) :: status

    call set_ok(status)
    nullify (handle)
    if (c_associated(place)) then
      call c_f_pointer(place, handle)
      handle = c_null_ptr
    else
      call fail(status, status_input_error, 'handle', 'the room for the handle: is NULL, must be' &
                //' the address of one')
    end if
  end subroutine result_place

  !> Read groups as a scene. Files that they name may be anywhere, since a program requests them.
  subroutine read_call(groups, scene, status)
    character(len=*), intent(in) :: groups
    type(scene_type), intent(out), target :: scene
    type(status_type), intent(out) :: status
    call read_scene(call_path, scene, status, groups, allow_paths=.true.)
  end subroutine read_call

  !> Check that groups define a system. Returns its number of coordinates.
  subroutine check_system(groups, n, status)
    character(len=*), intent(in) :: groups
    integer, intent(out) :: n
    type(status_type), intent(out) :: status
    type(scene_type) :: scene

    n = 0
    ! An analysis that is valid for any system without a load.
    call read_call(groups//'&modes /'//nl, scene, status)
    if (.not. status%failed()) n = size(scene%subject%coordinates)
  end subroutine check_system

  !> Create a handle for groups that define a system.
  subroutine make_handle(groups, handle, status)
    character(len=*), intent(in) :: groups
    type(c_ptr), intent(out) :: handle
    type(status_type), intent(out) :: status
    type(c_system), pointer :: system
    integer :: n

    handle = c_null_ptr
    call check_system(groups, n, status)
    if (status%failed()) return
    allocate (system)
    system%text = groups
    system%n_coordinates = n
    handle = c_loc(system)
  end subroutine make_handle

  integer(c_int) function system_new(n, mass, damping, stiffness, place) &
    bind(c, name='viscovib_system_new')
    integer(c_int), value :: n
    type(c_ptr), value :: mass, damping, stiffness, place
    type(c_ptr), pointer :: handle
    type(status_type) :: status
    character(len=:), allocatable :: text
    integer :: i

    call result_place(place, handle, status)
    if (status%failed()) then
      system_new = description(status)
      return
    end if
    if (n < 1 .or. n > max_coordinates) then
      call fail(status, status_input_error, 'n', 'n = '//show(int(n))//': must be 1 to ' &
                //show(max_coordinates)//' coordinates')
    else if (.not. (c_associated(mass) .and. c_associated(stiffness))) then
      call fail(status, status_input_error, 'mass', 'mass, stiffness: must not be NULL')
    else
      text = '&system coordinates ='
      do i = 1, n
        text = text//" 'x"//show(i)//"'"
      end do
      text = text//', kernel = 0,'//matrix_text('mass', mass, int(n)) &
             //matrix_text('stiffness', stiffness, int(n))
      if (c_associated(damping)) text = text//matrix_text('damping', damping, int(n))
      call make_handle(text//' /'//nl, handle, status)
    end if
    system_new = description(status)
  end function system_new

  !> A C matrix as a key.
  function matrix_text(name, place, n) result(text)
    character(len=*), intent(in) :: name
    type(c_ptr), intent(in) :: place
    integer, intent(in) :: n
    character(len=:), allocatable :: text
    real(c_double), pointer :: values(:)

    call c_f_pointer(place, values, [n*n])
    text = numbers_text(name, values)
  end function matrix_text

  integer(c_int) function system_read(groups, place) bind(c, name='viscovib_system_read')
    type(c_ptr), value :: groups, place
    type(c_ptr), pointer :: handle
    type(status_type) :: status

    call result_place(place, handle, status)
    if (.not. status%failed()) call make_handle(text_of(groups)//nl, handle, status)
    system_read = description(status)
  end function system_read

  integer(c_int) function system_add(handle, group, keys) bind(c, name='viscovib_system_add')
    type(c_ptr), value :: handle, group, keys
    type(status_type) :: status

    call add(handle, '&'//text_of(group)//' '//text_of(keys)//' /'//nl, status)
    system_add = description(status)
  end function system_add

  integer(c_int) function system_add_spring(handle, stiffness, kernel) &
    bind(c, name='viscovib_system_add_spring')
    type(c_ptr), value :: handle, stiffness
    integer(c_int), value :: kernel
    type(c_system), pointer :: system
    type(status_type) :: status

    call system_of(handle, system, status)
    if (.not. status%failed()) then
      if (c_associated(stiffness)) then
        call add(handle, '&spring'//matrix_text('stiffness', stiffness, system%n_coordinates) &
                 //' kernel = '//show(int(kernel))//' /'//nl, status)
      else
        call fail(status, status_input_error, 'stiffness', 'stiffness: must not be NULL')
      end if
    end if
    system_add_spring = description(status)
  end function system_add_spring

  !> Add a group to a system if the result is valid.
  subroutine add(handle, group, status)
    type(c_ptr), intent(in) :: handle
    character(len=*), intent(in) :: group
    type(status_type), intent(out) :: status
    type(c_system), pointer :: system
    integer :: n

    call system_of(handle, system, status)
    if (status%failed()) return
    call check_system(system%text//group, n, status)
    if (.not. status%failed()) system%text = system%text//group
  end subroutine add

  subroutine system_free(handle) bind(c, name='viscovib_system_free')
    type(c_ptr), value :: handle
    type(c_system), pointer :: system
    if (.not. c_associated(handle)) return
    call c_f_pointer(handle, system)
    deallocate (system)
  end subroutine system_free

end module viscovib_c_systems
