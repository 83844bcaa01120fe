!> A vector of numbers that is read from its beginning to its end.
module viscovib_number_reader
  use viscovib_catalogue, only: new_kernel
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term, new_law_term
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  implicit none
  private

  public :: number_reader

  type :: number_reader
    !> All numbers, and how many of them were read.
    real(wp), allocatable :: numbers(:)
    integer :: at = 0
  contains
    procedure :: start
    procedure :: count_left
    procedure :: whole
    procedure :: row
    procedure :: pairs
    procedure :: matrix
    procedure :: pair_matrix
    procedure :: laws
    procedure :: kernels
  end type number_reader

contains

  !> Start at the first number. Fails if there are fewer than `least`.
  subroutine start(self, numbers, least, what, status)
    class(number_reader), intent(out) :: self
    real(wp), intent(in) :: numbers(:)
    integer, intent(in) :: least
    !> What the vector should describe.
    character(len=*), intent(in) :: what
    type(status_type), intent(out) :: status
    call set_ok(status)
    if (size(numbers) < least) then
      call fail(status, status_input_error, 'system', 'system: not a '//what)
    end if
    self%numbers = numbers
  end subroutine start

  pure integer function count_left(self)
    class(number_reader), intent(in) :: self
    count_left = size(self%numbers) - self%at
  end function count_left

  !> The next number, which is whole.
  integer function whole(self)
    class(number_reader), intent(inout) :: self
    self%at = self%at + 1
    whole = nint(self%numbers(self%at))
  end function whole

  !> The next n numbers.
  function row(self, n)
    class(number_reader), intent(inout) :: self
    integer, intent(in) :: n
    real(wp) :: row(n)
    row = self%numbers(self%at + 1:self%at + n)
    self%at = self%at + n
  end function row

  !> The next n complex numbers, with alternating real and imaginary parts.
  function pairs(self, n)
    class(number_reader), intent(inout) :: self
    integer, intent(in) :: n
    complex(wp) :: pairs(n)
    real(wp) :: parts(2*n)
    parts = self%row(2*n)
    pairs = cmplx(parts(1::2), parts(2::2), wp)
  end function pairs

  !> The next matrix, in column-major order.
  function matrix(self, m, n)
    class(number_reader), intent(inout) :: self
    integer, intent(in) :: m, n
    real(wp) :: matrix(m, n)
    matrix = reshape(self%row(m*n), [m, n])
  end function matrix

  !> The next complex matrix.
  function pair_matrix(self, m, n)
    class(number_reader), intent(inout) :: self
    integer, intent(in) :: m, n
    complex(wp) :: pair_matrix(m, n)
    pair_matrix = reshape(self%pairs(m*n), [m, n])
  end function pair_matrix

  !> The number of laws of n coordinates, and each law (`new_law_term`).
  subroutine laws(self, n, terms)
    class(number_reader), intent(inout) :: self
    integer, intent(in) :: n
    type(law_term), allocatable, intent(out) :: terms(:)
    integer :: i, used

    allocate (terms(self%whole()))
    do i = 1, size(terms)
      call new_law_term(terms(i), self%numbers(self%at + 1:), n, used)
      self%at = self%at + used
    end do
  end subroutine laws

  !> The next n kernels: of each its kind, the number of its data, and these.
  subroutine kernels(self, n, holders, status)
    class(number_reader), intent(inout) :: self
    integer, intent(in) :: n
    type(kernel_holder), allocatable, intent(out) :: holders(:)
    type(status_type), intent(out) :: status
    integer :: i, kind

    call set_ok(status)
    allocate (holders(n))
    do i = 1, n
      kind = self%whole()
      call new_kernel(holders(i)%kernel, kind, self%row(self%whole()), status)
      if (status%failed()) return
    end do
  end subroutine kernels

end module viscovib_number_reader
