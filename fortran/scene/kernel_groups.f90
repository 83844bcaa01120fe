!> The &kernel groups of a scene: which kernel acts on which spring.
module viscovib_kernel_groups
  use viscovib_catalogue, only: kernel_abel, kernel_names, kernel_prony, kernel_rabotnov, &
    kernel_rzhanitsyn, new_kernel
  use viscovib_fitted_kernel, only: read_fitted
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kernel_table, only: check_pairs, read_pairs
  use viscovib_kinds, only: wp
  use viscovib_mount, only: mount_parameters
  use viscovib_namelist, only: namelist_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: read_kernels, read_system_kernels

  integer, parameter :: max_kernels = 64

contains

  subroutine read_kernels(file, kernels, parameters, echo, status)
    type(namelist_type), intent(in) :: file
    type(kernel_holder), intent(inout) :: kernels(2)
    !> Gets which kernel acts on which spring.
    type(mount_parameters), intent(inout) :: parameters
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: acts_on
    integer :: i, n

    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'kernel') cycle
      call reader%start(file%path, file%groups(i))
      acts_on = reader%read_text('acts_on')
      if ((acts_on /= 'phi' .and. parameters%kernel_x > 0) &
          .or. (acts_on /= 'x' .and. parameters%kernel_phi > 0)) then
        call reader%complain('acts_on', "acts_on = '"//acts_on//"': this spring has a kernel " &
                             //'already; give one for x and one for phi, or one for both')
      end if
      if (.not. reader%status%failed()) then
        n = n + 1
        if (acts_on /= 'phi') parameters%kernel_x = n
        if (acts_on /= 'x') parameters%kernel_phi = n
        call read_kernel(reader, kernels(n))
      end if
      call reader%close(echo, status)
      if (status%failed()) return
    end do
  end subroutine read_kernels

  !> All kernels of a polynomial system; its springs and forces name them by place.
  subroutine read_system_kernels(file, kernels, echo, status)
    type(namelist_type), intent(in) :: file
    type(kernel_holder), allocatable, intent(out) :: kernels(:)
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    integer :: i, n

    n = count([(file%groups(i)%name == 'kernel', i=1, size(file%groups))])
    if (n > max_kernels) then
      call fail(status, status_input_error, 'kernel', file%path//': '//show(n) &
                //' &kernel groups: must be at most '//show(max_kernels))
      return
    end if
    allocate (kernels(n))
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'kernel') cycle
      n = n + 1
      call reader%start(file%path, file%groups(i))
      call reader%refuse(['acts_on'], 'belongs to a mount; here the groups with stiffness or a ' &
                         //'law have the key kernel')
      call read_kernel(reader, kernels(n))
      call reader%close(echo, status)
      if (status%failed()) return
    end do
  end subroutine read_system_kernels

  subroutine read_kernel(reader, holder)
    type(group_reader), intent(inout) :: reader
    type(kernel_holder), intent(inout) :: holder
    type(status_type) :: status
    character(len=:), allocatable :: word
    real(wp), allocatable :: p(:), second(:)
    integer :: kind
    !> Follows the kinds that a scene spells out: a file contains everything.
    integer, parameter :: kind_fitted = size(kernel_names)

    allocate (second(0))
    word = reader%read_text('kind', choice=kind)
    if (reader%status%failed()) return
    select case (kind)
    case (kernel_rzhanitsyn, kernel_rabotnov, kernel_abel)
      allocate (p(merge(2, 3, kind == kernel_abel)))
      p(1) = reader%read_real('amplitude')
      p(2) = reader%read_real('alpha')
      if (kind /= kernel_abel) p(3) = reader%read_real('beta')
    case (kernel_prony)
      p = reader%read_reals('weights')
      second = reader%read_reals('rates')
      call check_pairs(reader, 'weights', 'rates', size(p), size(second))
      p = [p, second]
    case (kind_fitted)
      call read_fitted(reader, kind, p)
    case default
      call read_tabulated(reader, p)
    end select
    if (reader%status%failed()) return
    call new_kernel(holder%kernel, kind, p, status)
    if (status%failed() .and. reader%has('file')) then
      call reader%complain('file', 'file: '//status%message)
    else if (status%failed() .and. reader%has('numbers')) then
      call reader%complain('numbers', 'numbers: '//status%message)
    end if
    call reader%place(status)
  end subroutine read_kernel

  !> Times and values, here or in a file of two columns.
  subroutine read_tabulated(reader, p)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: p(:)
    character(len=:), allocatable :: word
    real(wp), allocatable :: times(:), values(:)
    integer :: code

    word = reader%read_text('interpolation', choice=code)
    call read_pairs(reader, times, values)
    p = [real(code - 1, wp), times, values]
  end subroutine read_tabulated

end module viscovib_kernel_groups
