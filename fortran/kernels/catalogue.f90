!> Creates a kernel from its kind and a flat list of numbers, as in scenes and bindings.
module viscovib_catalogue
  use viscovib_kernel, only: kernel_type
  use viscovib_kernel_sum, only: kernel_sum
  use viscovib_kinds, only: wp
  use viscovib_prony, only: new_prony, prony_kernel
  use viscovib_rabotnov, only: new_rabotnov, rabotnov_kernel
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_tabulated, only: new_tabulated, tabulated_kernel
  implicit none
  private

  public :: new_kernel

  !> Kinds, and the content of `parameters` for each:
  !! rzhanitsyn, rabotnov: amplitude, alpha, beta; abel: amplitude, alpha; prony: all weights, all
  !! rates; tabulated: interpolation, all times, all values; sum: for each part its kind, its number
  !! of parameters, and these.
  integer, parameter, public :: kernel_none = 0, kernel_rzhanitsyn = 1, kernel_prony = 2, &
                                kernel_abel = 3, kernel_rabotnov = 4, kernel_tabulated = 5, &
                                kernel_sum_of = 6
  character(len=*), parameter, public :: kernel_names(6) = &
    [character(len=10) :: 'rzhanitsyn', 'prony', 'abel', 'rabotnov', 'tabulated', &
     'sum']

contains

  recursive subroutine new_kernel(kernel, kind, parameters, status)
    class(kernel_type), allocatable, intent(out) :: kernel
    integer, intent(in) :: kind
    real(wp), intent(in) :: parameters(:)
    type(status_type), intent(out) :: status
    type(rzhanitsyn_kernel) :: rzhanitsyn
    type(prony_kernel) :: prony
    type(rabotnov_kernel) :: rabotnov
    type(tabulated_kernel) :: tabulated
    integer :: n

    call check_length(kind, size(parameters), status)
    if (status%failed()) return
    associate (p => parameters)
      select case (kind)
      case (kernel_rzhanitsyn)
        call new_rzhanitsyn(rzhanitsyn, p(1), p(2), p(3), status)
        allocate (kernel, source=rzhanitsyn)
      case (kernel_abel)
        call new_rzhanitsyn(rzhanitsyn, p(1), p(2), 0.0_wp, status)
        allocate (kernel, source=rzhanitsyn)
      case (kernel_rabotnov)
        call new_rabotnov(rabotnov, p(1), p(2), p(3), status)
        allocate (kernel, source=rabotnov)
      case (kernel_prony)
        n = size(p)/2
        call new_prony(prony, p(:n), p(n + 1:), status)
        allocate (kernel, source=prony)
      case (kernel_sum_of)
        call new_sum(kernel, p, status)
        return
      case default
        n = (size(p) - 1)/2
        call new_tabulated(tabulated, p(2:n + 1), p(n + 2:), nint(p(1)), status)
        allocate (kernel, source=tabulated)
      end select
    end associate
    if (status%failed()) deallocate (kernel)
  end subroutine new_kernel

  !> Read the parts one by one. An invalid kind or count is an error.
  recursive subroutine new_sum(kernel, numbers, status)
    class(kernel_type), allocatable, intent(out) :: kernel
    real(wp), intent(in) :: numbers(:)
    type(status_type), intent(out) :: status
    type(kernel_sum), allocatable :: whole
    integer :: first, length, n

    n = 0
    first = 1
    do while (first < size(numbers))
      n = n + 1
      if (.not. (numbers(first + 1) >= 0.0_wp .and. numbers(first + 1) <= size(numbers))) exit
      if (.not. (numbers(first) >= 1.0_wp .and. numbers(first) < kernel_sum_of)) exit
      first = first + 2 + nint(numbers(first + 1))
    end do
    if (first /= size(numbers) + 1 .or. n == 0) then
      call fail(status, status_input_error, 'parts', 'parts: must be one or more kernels, each ' &
                //'by its kind, how many numbers it has, and these')
      return
    end if
    allocate (whole)
    allocate (whole%parts(n))
    first = 1
    do n = 1, size(whole%parts)
      length = nint(numbers(first + 1))
      call new_kernel(whole%parts(n)%kernel, nint(numbers(first)), &
                      numbers(first + 2:first + 1 + length), status)
      if (status%failed()) return
      first = first + 2 + length
    end do
    call move_alloc(whole, kernel)
  end subroutine new_sum

  subroutine check_length(kind, n, status)
    integer, intent(in) :: kind, n
    type(status_type), intent(out) :: status
    logical :: fits

    select case (kind)
    case (kernel_rzhanitsyn, kernel_rabotnov)
      fits = n == 3
    case (kernel_abel)
      fits = n == 2
    case (kernel_prony)
      fits = mod(n, 2) == 0
    case (kernel_tabulated)
      fits = mod(n, 2) == 1
    case (kernel_sum_of)
      fits = n > 1
    case default
      call fail(status, status_input_error, 'kind', 'kind = '//show(kind) &
                //': must be 1 to '//show(size(kernel_names)))
      return
    end select
    if (.not. fits) call fail(status, status_input_error, 'kernel', 'kernel of kind ' &
                              //trim(kernel_names(kind))//': '//show(n)//' numbers do not fit')
  end subroutine check_length

end module viscovib_catalogue
