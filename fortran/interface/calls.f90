! Optimize: -O1
!> Calls of the interface, with packed input and output. The f2py and C interfaces are thin layers
!! over these calls.
!!
!! A call has a text, integers and numbers. The text consists of the kind of the task, a semicolon,
!! the comma-separated names of the values, a semicolon, and the letters of all texts. The integers
!! are the number of objects that the task uses and their handles; for each value its kind, rank and
!! extents; then the elements of all integer values. The numbers are the elements of all real and
!! complex values. Results have the same form, without the kind and the handles; each name is
!! followed by a comma.
module viscovib_calls
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_backbone_tasks, only: backbone_task
  use viscovib_branch_tasks, only: branch_task
  use viscovib_drive_tasks, only: drive_task
  use viscovib_ensemble_tasks, only: ensemble_task
  use viscovib_handles, only: add_object, find_objects, release, remove_object
  use viscovib_kernel_tasks, only: kernel_task
  use viscovib_kinds, only: i8, wp
  use viscovib_law_tasks, only: law_task
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_motion_tasks, only: motion_task
  use viscovib_named_values, only: most_dimensions, named_values
  use viscovib_response_tasks, only: response_task
  use viscovib_scales_tasks, only: scales_task
  use viscovib_scene_tasks, only: scene_task
  use viscovib_spectrum_tasks, only: spectrum_task
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_system_tasks, only: system_task
  use viscovib_task, only: task_link, task_type
  implicit none
  private

  public :: begin_call, end_call, free_object

contains

  !> Run a task. The handle belongs to its results, or to the created object.
  subroutine begin_call(text, integers, numbers, keep, cancel, handle, sizes, status)
    character(len=*), intent(in) :: text
    integer(i8), intent(in) :: integers(:)
    real(wp), intent(in), target, contiguous :: numbers(:)
    !> The values are used by later tasks: copy the numbers.
    logical, intent(in) :: keep
    !> Set to a nonzero value by another thread to cancel the task.
    integer(c_int), intent(inout), target :: cancel
    integer(i8), intent(out) :: handle
    !> Numbers of letters, integers and numbers for `end_call`, and the address of the numbers.
    integer(i8), intent(out) :: sizes(4)
    type(status_type), intent(out) :: status
    type(task_type), pointer :: task
    type(task_link) :: link

    handle = 0
    sizes = 0
    allocate (task)
    call unpack_call(task, text, integers, size(numbers, kind=i8), status)
    if (.not. status%failed()) then
      if (keep) then
        call task%given%keep_numbers(numbers)
      else
        task%given%numbers => numbers
      end if
      task%cancel => cancel
      call run_task(task)
      nullify (task%cancel)
      if (.not. keep) then
        ! Values whose numbers may not exist any more are not found.
        task%given%n = 0
        nullify (task%given%numbers)
      end if
      status = task%status
    end if
    if (status%failed()) then
      link%to => task
      call release(link)
      return
    end if
    sizes = [sizes_of(task%found), task%found%address()]
    handle = add_object(task)
  end subroutine begin_call

  !> Return the results of a task and free its handle. If `numbers` is empty and the task has
  !! numbers, the handle keeps them at their address.
  subroutine end_call(handle, text, integers, numbers, status)
    integer(i8), intent(in) :: handle
    character(len=1), intent(out) :: text(:)
    integer(i8), intent(out) :: integers(:)
    real(wp), intent(out) :: numbers(:)
    type(status_type), intent(out) :: status
    type(task_link) :: links(1)
    integer(i8) :: sizes(3)
    logical :: keep

    call find_objects([handle], links, status)
    if (status%failed()) return
    associate (found => links(1)%to%found)
      sizes = sizes_of(found)
      keep = size(numbers) == 0 .and. sizes(3) > 0
      if (keep) sizes(3) = 0
      if (any([size(text, kind=i8), size(integers, kind=i8), size(numbers, kind=i8)] /= sizes)) then
        call fail(status, status_input_error, 'handle', 'handle: its results have another size')
      else
        call pack_found(found, text, integers, numbers)
      end if
    end associate
    call release(links(1))
    if (.not. (keep .or. status%failed())) call remove_object(handle, status)
  end subroutine end_call

  subroutine free_object(handle, status)
    integer(i8), intent(in) :: handle
    type(status_type), intent(out) :: status
    call remove_object(handle, status)
  end subroutine free_object

  !> Declare all values, and copy integers and letters.
  subroutine unpack_call(task, text, integers, n_numbers, status)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: text
    integer(i8), intent(in) :: integers(:), n_numbers
    type(status_type), intent(out) :: status
    integer(i8) :: n, at, rank
    integer :: first, last, names_end

    call set_ok(status)
    last = index(text, ';')
    names_end = last + index(text(last + 1:), ';')
    n = 0
    if (size(integers) > 0) n = integers(1)
    if (last == 0 .or. names_end == last .or. n < 0 .or. n > size(integers) - 1) then
      call refuse_call(status)
      return
    end if
    task%kind = text(:last - 1)
    if (n > 0) then
      allocate (task%parents(n))
      call find_objects(integers(2:n + 1), task%parents, status)
      if (status%failed()) then
        deallocate (task%parents)
        return
      end if
    end if
    at = n + 2
    first = last + 1
    do while (first < names_end)
      last = first + scan(text(first:names_end), ',;') - 2
      if (at + 1 > size(integers)) exit
      rank = integers(at + 1)
      if (rank < 0 .or. rank > most_dimensions .or. at + 1 + rank > size(integers)) exit
      call task%given%declare(text(first:last), int(integers(at)), &
                              int(integers(at + 2:at + 1 + rank)))
      at = at + 2 + rank
      first = last + 2
    end do
    if (first < names_end .or. size(integers) - at + 1 /= task%given%n_integers &
        .or. n_numbers /= task%given%n_numbers &
        .or. len(text) - names_end /= task%given%n_letters) then
      call refuse_call(status)
      return
    end if
    task%given%integers = integers(at:)
    task%given%letters = text(names_end + 1:)
  end subroutine unpack_call

  subroutine refuse_call(status)
    type(status_type), intent(inout) :: status
    call fail(status, status_input_error, 'task', 'task: its names, extents and ' &
              //'elements do not fit')
  end subroutine refuse_call

  pure function sizes_of(found) result(sizes)
    type(named_values), intent(in) :: found
    integer(i8) :: sizes(3)
    integer :: i
    sizes = [found%n_letters, found%n_integers, found%n_numbers]
    do i = 1, found%n
      sizes(1) = sizes(1) + found%places(i)%name_length + 1
      sizes(2) = sizes(2) + 2 + found%places(i)%rank
    end do
    sizes(1) = sizes(1) + 1
  end function sizes_of

  subroutine pack_found(found, text, integers, numbers)
    type(named_values), intent(in) :: found
    character(len=1), intent(out) :: text(:)
    integer(i8), intent(out) :: integers(:)
    real(wp), intent(out) :: numbers(:)
    integer :: i, j, n_text, n

    n_text = 0
    n = 0
    do i = 1, found%n
      associate (place => found%places(i))
        do j = 1, place%name_length
          text(n_text + j) = place%name(j:j)
        end do
        n_text = n_text + place%name_length + 1
        text(n_text) = ','
        integers(n + 1) = place%kind
        integers(n + 2) = place%rank
        integers(n + 3:n + 2 + place%rank) = place%extents(:place%rank)
        n = n + 2 + place%rank
      end associate
    end do
    n_text = n_text + 1
    text(n_text) = ';'
    do j = 1, int(found%n_letters)
      text(n_text + j) = found%letters(j:j)
    end do
    if (found%n_integers > 0) integers(n + 1:) = found%integers(:found%n_integers)
    if (size(numbers) > 0) numbers = found%numbers(:found%n_numbers)
  end subroutine pack_found

  ! All tasks by name. The first word of the name is the family, which has a module.

  !> Run a task by its kind.
  subroutine run_task(task)
    type(task_type), intent(inout) :: task
    character(len=:), allocatable :: name
    integer :: space
    logical :: of_texts

    space = index(task%kind//' ', ' ')
    name = task%kind(space + 1:)
    ! Compiling and planning create many texts.
    of_texts = index(name, 'plan') > 0 .or. index(name, 'compile') > 0
    if (of_texts) call lock_texts()
    select case (task%kind(:space - 1))
    case ('backbone')
      call backbone_task(task, name)
    case ('branch')
      call branch_task(task, name)
    case ('drive')
      call drive_task(task, name)
    case ('ensemble')
      call ensemble_task(task, name)
    case ('kernel')
      call kernel_task(task, name)
    case ('law')
      call law_task(task, name)
    case ('motion')
      call motion_task(task, name)
    case ('response')
      call response_task(task, name)
    case ('scales')
      call scales_task(task, name)
    case ('scene')
      call scene_task(task, name)
    case ('spectrum')
      call spectrum_task(task, name)
    case ('system')
      call system_task(task, name)
    case ('values')
      ! Only kept, for tasks that use this object.
      continue
    case default
      call task%refuse_kind()
    end select
    if (of_texts) call unlock_texts()
  end subroutine run_task

end module viscovib_calls
